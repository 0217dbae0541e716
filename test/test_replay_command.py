"""The command `align_replay`: exit codes, one-line errors, what it prints and writes."""

from __future__ import annotations

import csv
import fcntl
import json
import math
import os
import pty
import re
import select
import shutil
import struct
import subprocess
import sys
import termios
from pathlib import Path
from typing import Any, NamedTuple

import pytest

pytest.importorskip("rosbags")

from sins_align.ros import replay_command, simulate_command
from sins_align.ros.bags import open_bag

ROOT = Path(__file__).resolve().parent.parent
EASY = ["-p", "heading_threshold_arcmin:=20", "-p", "level_threshold_arcsec:=60", "-p", "hold_s:=2"]

HARD = ["-p", "heading_threshold_arcmin:=0.01"]  # below what the declared gyro allows
DEADLINE_S = 180.0  # on a machine that does much else


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """60 s of a swing at 100 Hz, with fix and truth."""
    path = tmp_path_factory.mktemp("bags") / "swing"
    words = ["swing", "--rate", "100", "--duration", "60", "--seed", "3", "--quiet"]
    assert simulate_command.main([*words, "--out", str(path)]) == 0
    return path


class Done(NamedTuple):
    status: int
    out: str
    err: str


@pytest.fixture
def replay(capfd: pytest.CaptureFixture[str]) -> Any:
    def run(*words: object) -> Done:
        try:
            status = replay_command.main([str(word) for word in words])
        except SystemExit as leaving:  # argparse
            status = int(leaving.code or 0)
        return Done(status, *capfd.readouterr())

    return run


def test_aligned_is_status_0_and_not_yet_is_3(replay: Any, bag: Path) -> None:
    done = replay("swing", bag, *EASY)
    assert (done.status, done.err) == (0, "")
    assert "aligned after" in done.out
    done = replay("swing", bag, *HARD)
    assert done.status == 3
    assert "not aligned (fine)" in done.out


def test_truth_is_printed_beside_the_result(replay: Any, bag: Path) -> None:
    done = replay("swing", bag, "--truth", bag / "truth.json", *EASY)
    heading = next(line for line in done.out.splitlines() if line.startswith("heading "))
    assert abs(float(heading.split()[-1])) < 4.0
    bias = next(line for line in done.out.splitlines() if line.startswith("gyro bias z"))
    truth = json.loads((bag / "truth.json").read_text())
    deg_h = math.degrees(truth["gyro_bias_rad_s"][2]) * 3600.0
    assert float(bias.split()[7]) == pytest.approx(deg_h, abs=1e-5)
    assert "-0.0 " not in done.out
    cut = replay("swing", bag, "--truth", bag / "truth.json", "--duration", 40)
    assert "that of another time" in cut.out


def test_json_to_stdout_is_all_there_is(replay: Any, bag: Path) -> None:
    done = replay("swing", bag, "--json", "-", *EASY)
    document = json.loads(done.out)
    truth = json.loads((bag / "truth.json").read_text())
    assert document["aligned"] is True
    assert document["stamp_ns"] == truth["stamp_ns"]
    assert document["input"]["imu_samples"] == 6001
    assert list(document) == [
        "schema", "node", "method", "aligned", "aligned_at_s", "state", "reason", "stamp_ns",
        "q_nb_wxyz", "roll_deg", "pitch_deg", "heading_deg", "misalignment_covariance_rad2",
        "sigma_arcmin", "heading_limit_arcmin", "gyro_bias_rad_s", "gyro_bias_sigma_rad_s",
        "accel_bias_m_s2", "accel_bias_sigma_m_s2", "lever_arm_m", "lever_arm_sigma_m",
        "lever_arm_observable", "odometer_scale_error", "odometer_scale_sigma",
        "mounting_rpy_deg", "mounting_sigma_deg", "odometer_latency_s",
        "odometer_latency_sigma_s", "odometer_lever_arm_m", "odometer_lever_arm_sigma_m",
        "consistency", "input", "timing",
    ]  # fmt: skip


def test_written_files(replay: Any, bag: Path, tmp_path: Path) -> None:
    out = tmp_path / "a" / "b"
    for _ in range(2):  # a second run replaces what the first one wrote
        done = replay("swing", bag, "--out", out, "--bag", "-p", "publish_rate_hz:=10", *EASY)
        assert done.status == 0, done.err
        names = ["aligned.mcap", "estimates.csv", "report.html", "result.json"]
        assert sorted(path.name for path in out.iterdir()) == names
    document = json.loads((out / "result.json").read_text())
    rows = list(csv.DictReader((out / "estimates.csv").open()))
    assert 20 <= len(rows) <= 60
    assert rows[-1]["state"] == "aligned"
    assert float(rows[-1]["heading_sigma_arcmin"]) < 20.0
    assert rows[0]["heading_deg"] == ""
    report = (out / "report.html").read_text()
    assert report.count("<svg") == 5
    assert "http" not in report  # nothing to load
    with open_bag([out / "aligned.mcap"]) as aligned:
        messages = [message for _, message in aligned.read_messages("/swing_align/attitude")]
        levers = [message for _, message in aligned.read_messages("/swing_align/lever_arm")]
    q = messages[-1].orientation
    # The result makes more of the last seconds than what is published as they come.
    assert [q.w, q.x, q.y, q.z] == pytest.approx(document["q_nb_wxyz"], abs=1e-3)
    stamp = messages[-1].header.stamp
    assert stamp.sec * 10**9 + stamp.nanosec == document["stamp_ns"]
    position = levers[-1].pose.pose.position
    assert [position.x, position.y, position.z] == pytest.approx(document["lever_arm_m"], abs=1e-2)


def test_an_unobservable_lever_arm_is_no_number(replay: Any, tmp_path: Path) -> None:
    words = ["swing", "--scenario", "still", "--rate", "50", "--duration", "40", "--quiet"]
    assert simulate_command.main([*words, "--out", str(tmp_path / "bag")]) == 0
    done = replay("swing", tmp_path / "bag", "--out", tmp_path / "out")
    assert done.out.count(" unobservable\n") == 3
    row = list(csv.DictReader((tmp_path / "out" / "estimates.csv").open()))[-1]
    assert (row["lever_x_m"], row["lever_x_sigma_m"]) == ("", "")
    assert row["heading_deg"] != ""
    assert (tmp_path / "out" / "report.html").read_text().count("<svg") == 3


def test_charts_show_the_swing_and_not_the_updates(replay: Any, bag: Path, tmp_path: Path) -> None:
    """Estimates are made anew every few seconds: a line through them is no picture of a swing."""
    replay("swing", bag, "--out", tmp_path, "--quiet", *HARD)
    report = (tmp_path / "report.html").read_text()
    heading = report.partition("Heading [deg]")[2].partition("</svg>")[0]
    (line,) = re.findall(r'<path d="([^"]*)" fill="none"', heading)
    assert len(re.findall("[ML]", line)) >= 40
    assert line.count("M") == 1


def test_recording_the_attitude_changes_no_number(replay: Any, bag: Path, tmp_path: Path) -> None:
    plain = json.loads(replay("swing", bag, "--json", "-").out)
    recorded = json.loads(
        replay("swing", bag, "--json", "-", "--bag", "--out", tmp_path, "-p",
               "publish_rate_hz:=3").out
    )  # fmt: skip
    del plain["timing"], recorded["timing"]
    assert plain == recorded


def test_parameter_file_and_overrides(replay: Any, bag: Path, tmp_path: Path) -> None:
    file = tmp_path / "params.yaml"
    file.write_text(
        "/**:\n  ros__parameters:\n    use_sim_time: true\n"
        "    qos_overrides: {/imu: {subscription: {depth: 5000}}}\n"
        "swing_align:\n  ros__parameters:\n    hold_s: 2\n    heading_threshold_arcmin: 20.0\n"
    )
    done = replay("swing", bag, "--params", file, "-p", "level_threshold_arcsec:=60", "--quiet")
    assert done == (0, "", "")
    done = replay("swing", bag, "--params", file, *EASY, "-p", "heading_threshold_arcmin:=0.1")
    assert done.status == 3
    assert replay("swing", bag, "-p", "use_sim_time:=true", *HARD).status == 3
    shipped = ROOT / "config" / "swing_align.yaml"
    assert replay("swing", bag, "--params", shipped, *HARD).status == 3


def test_part_of_a_bag(replay: Any, bag: Path) -> None:
    part = ["--start", 10, "--duration", 20]
    document = json.loads(replay("swing", bag, *part, "--json", "-").out)
    assert document["input"]["imu_samples"] == 2000


def test_position_is_needed(replay: Any, bag: Path, tmp_path: Path) -> None:
    from sins_align.ros.bags_write import ImuBagWriter

    with open_bag([bag]) as source, ImuBagWriter(tmp_path / "nofix") as target:
        for samples in source.read_imu("/imu"):
            target.write_samples(samples)
    done = replay("swing", tmp_path / "nofix")
    assert done.status == 2
    assert "--latitude-deg" in done.err
    given = replay("swing", tmp_path / "nofix", "--latitude-deg", 40, "--altitude-m", 50, *HARD)
    assert given.status == 3


def test_a_truncated_bag_is_used_as_far_as_it_goes(replay: Any, bag: Path, tmp_path: Path) -> None:
    whole = (bag / f"{bag.name}.mcap").read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole[: int(0.7 * len(whole))])
    done = replay("swing", cut, "--json", "-")
    assert done.status == 3
    assert "warning" in done.err and str(cut) in done.err
    assert 2000 < json.loads(done.out)["input"]["imu_samples"] < 6001


def test_what_is_computed_is_shown_though_it_cannot_be_written(replay: Any, bag: Path) -> None:
    done = replay("swing", bag, "--json", "/dev/null/result.json")
    assert done.status == 2
    assert "heading " in done.out
    assert done.err.count("\n") == 1 and "/dev/null/result.json" in done.err


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ([], "required"),
        (["swing"], "BAG"),
        (["odo", "/nonexistent"], "/nonexistent"),
        (["fly", "x"], "fly"),
        (["swing", "/nonexistent"], "/nonexistent"),
        (["swing", "BAG", "--imu-topic", "/other"], "/other"),
        (["swing", "BAG", "--fix-topic", "/other"], "/other"),
        (["swing", "BAG", "--params", "/nonexistent.yaml"], "/nonexistent.yaml"),
        (["swing", "BAG", "-p", "hold:=3"], "hold"),
        (["swing", "BAG", "-p", "hold_s:=soon"], "hold_s"),
        (["swing", "BAG", "-p", "imu_grade:=gold"], "gold"),
        (["swing", "BAG", "--latitude-deg", "91"], "latitude_deg"),
        (["swing", "BAG", "--duration", "-1"], "-1"),
        (["swing", "BAG", "--duration", "1e300"], "1e300"),
        (["swing", "BAG", "--start", "soon"], "soon is not a time"),
        (["swing", "BAG", "--start", "1000"], "part asked for"),
        (["swing", "BAG", "--bag"], "--out"),
        (["swing", "BAG", "--truth", "/nonexistent.json"], "/nonexistent.json"),
        (["swing", "BAG", "--truth", "BAG/metadata.yaml"], "metadata.yaml"),
        (["swing", "BAG", "--out", "/dev/null/x"], "/dev/null"),
        (["swing", __file__], "test_replay_command.py"),
    ],
)
def test_unusable_is_one_line_and_status_2(
    replay: Any, bag: Path, words: list[str], says: str
) -> None:
    done = replay(*(word.replace("BAG", str(bag)) for word in words))
    assert (done.status, done.out) == (2, "")
    (line,) = done.err.splitlines()
    assert says in line


def run_process(*words: object, stderr: int = subprocess.PIPE) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "sins_align.ros.replay_command", *map(str, words)],
        env={**os.environ, "PYTHONPATH": str(ROOT)}, text=True, stdout=subprocess.PIPE,
        stderr=stderr, timeout=DEADLINE_S, check=False,
    )  # fmt: skip


def test_progress_bar_on_a_terminal_and_none_in_a_pipe(bag: Path) -> None:
    assert run_process("swing", bag).stderr == ""
    terminal, other_end = pty.openpty()
    fcntl.ioctl(other_end, termios.TIOCSWINSZ, struct.pack("4H", 24, 80, 0, 0))
    done = run_process("swing", bag, *HARD, stderr=other_end)
    assert select.select([terminal], [], [], 0.0)[0], "nothing was shown"
    shown = os.read(terminal, 100_000).decode()
    os.close(other_end)
    os.close(terminal)
    assert done.returncode == 3
    assert "replay" in shown and "%" in shown


def test_a_reader_that_leaves_changes_nothing(bag: Path, tmp_path: Path) -> None:
    command = f"{sys.executable} -m sins_align.ros.replay_command swing {bag} --out {tmp_path}"
    shell = f"{{ {command} {' '.join(HARD)}; echo $? >&2; }} | true"
    done = subprocess.run(
        shell, shell=True, env={**os.environ, "PYTHONPATH": str(ROOT)}, text=True,
        capture_output=True, timeout=DEADLINE_S, check=False,
    )  # fmt: skip
    assert done.stderr == "3\n"
    assert (tmp_path / "report.html").exists()


def test_devices_and_links_are_written_to_not_replaced(
    replay: Any, bag: Path, tmp_path: Path
) -> None:
    pipe, link, target = tmp_path / "pipe", tmp_path / "link", tmp_path / "target"
    os.mkfifo(pipe)
    link.symlink_to(target)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    for path in (pipe, link):
        assert replay("swing", bag, "--quiet", "--json", path, *HARD) == (3, "", "")
    assert json.loads(os.read(reader, 100_000)) | {"timing": None} == json.loads(
        target.read_text()
    ) | {"timing": None}
    os.close(reader)
    assert pipe.is_fifo() and link.is_symlink()


def test_no_ros_is_needed(bag: Path, tmp_path: Path) -> None:
    for name in ("rclpy", "sensor_msgs"):
        (tmp_path / f"{name}.py").write_text("raise ImportError('not here')\n")
    words = ["sins_align.ros.replay_command", "swing", str(bag), "--quiet", *HARD]
    done = subprocess.run(
        [sys.executable, "-m", *words],
        env={**os.environ, "PYTHONPATH": f"{tmp_path}:{ROOT}"}, timeout=DEADLINE_S, check=False,
    )  # fmt: skip
    assert done.returncode == 3


def test_sqlite_and_bare_files_give_the_same(replay: Any, bag: Path, tmp_path: Path) -> None:
    words = ["swing", "--rate", "100", "--duration", "60", "--seed", "3", "--quiet"]
    other = tmp_path / "sqlite"
    assert simulate_command.main(
        [*words, "--storage", "sqlite3", "--compression", "zstd", "--out", str(other)]
    ) == 0  # fmt: skip
    bare = tmp_path / "bare.mcap"
    shutil.copy(bag / f"{bag.name}.mcap", bare)
    results = [json.loads(replay("swing", path, "--json", "-").out) for path in (bag, other, bare)]
    for result in results:
        del result["timing"]
    assert results[0] == results[1] == results[2]
