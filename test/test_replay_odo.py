"""The command `align_replay odo`: what it needs of a bag, what it prints and writes."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

pytest.importorskip("rosbags")

from sins_align.ros import replay_command
from sins_align.ros.bags import open_bag
from sins_align.ros.bags_topics import KINDS
from sins_align.ros.bags_write import BagWriter
from sins_align.simulate import VehicleOptions, VehicleRun, simulate_vehicle
from sins_align.types import IntArray, OdometerSamples

SECOND = 1_000_000_000
TWIST = KINDS["odom"][0]
PLACE = ["--latitude-deg", "40", "--longitude-deg", "116", "--altitude-m", "50"]
IMU = ["-p", "imu_grade:=fog"]
EASY = ["-p", "heading_threshold_arcmin:=60", "-p", "level_threshold_arcsec:=120"]
WORDS = [*PLACE, *IMU, *EASY, "-p", "hold_s:=2"]

MakeBag = Callable[..., Path]


class Done(NamedTuple):
    status: int
    out: str
    err: str

    @property
    def document(self) -> dict[str, Any]:
        document = json.loads(self.out)
        del document["timing"]
        return document


@pytest.fixture
def replay(capfd: pytest.CaptureFixture[str]) -> Callable[..., Done]:
    def run(bag: Path, *words: object) -> Done:
        try:
            status = replay_command.main(["odo", str(bag), *map(str, (*WORDS, *words))])
        except SystemExit as leaving:  # argparse
            status = int(leaving.code or 0)
        return Done(status, *capfd.readouterr())

    return run


@pytest.fixture(scope="module")
def drive() -> VehicleRun:
    """120 s on a ring at 50 Hz, with a covariance and a scale error of its own."""
    return simulate_vehicle(
        VehicleOptions(
            scenario="ring", seed=5, rate_hz=50.0, duration_s=120.0, odometer_rate_hz=10.0,
            odometer_report_variance=True, odometer_scale_error=0.012,
        )
    )  # fmt: skip


@pytest.fixture
def make_bag(drive: VehicleRun, tmp_path: Path) -> MakeBag:
    """Writes the drive, with odometers as given: topic, type, samples and log times."""

    def make(*odometers: tuple[str, str, OdometerSamples, IntArray], **options: Any) -> Path:
        path = tmp_path / f"bag{len(list(tmp_path.iterdir()))}"
        with BagWriter(path, **options) as bag:
            bag.write_imu(drive.imu)
            for topic, message_type, samples, log_time in odometers:
                bag.write_odometer(samples, log_time, message_type, topic=topic)
        return path

    return make


@pytest.fixture
def bag(drive: VehicleRun, make_bag: MakeBag) -> Path:
    return make_bag(("/odom", KINDS["odom"][1], drive.odometer, drive.odometer.stamp_ns))


def test_it_aligns_and_finds_what_is_to_be_known_of_the_odometer(
    replay: Any, bag: Path, drive: VehicleRun, tmp_path: Path
) -> None:
    truth = tmp_path / "truth.json"
    truth.write_text(json.dumps(drive.truth.truth_dict()))
    done = replay(bag, "--truth", truth)
    assert (done.status, done.err) == (0, "")
    lines = {line[:22].strip(): line.split() for line in done.out.splitlines()}
    for name in (
        "heading", "odometer scale error", "odometer latency", "odometer lever x", "mounting yaw"
    ):  # fmt: skip
        assert abs(float(lines[name][-1])) < 4.0, name
    assert "mounting roll" not in lines
    assert f"{len(drive.odometer)} samples of the odometer, 0 rejected" in done.out


def test_result_file(replay: Any, bag: Path, drive: VehicleRun) -> None:
    document = replay(bag, "--json", "-").document
    assert (document["node"], document["aligned"]) == ("odo_align", True)
    assert document["stamp_ns"] == drive.truth.stamp_ns
    assert document["lever_arm_m"] is None
    error = document["odometer_scale_error"] - 0.012
    assert abs(error) < 4.0 * document["odometer_scale_sigma"] < 0.02
    assert abs(document["odometer_latency_s"]) < 4.0 * document["odometer_latency_sigma_s"]
    for key in ("mounting_rpy_deg", "mounting_sigma_deg"):
        assert len(document[key]) == 3
    for value, sigma in zip(
        document["odometer_lever_arm_m"], document["odometer_lever_arm_sigma_m"], strict=True
    ):
        assert abs(value) < 4.0 * sigma
    assert document["input"]["odom_samples"] == len(drive.odometer)


def test_written_files(replay: Any, bag: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    done = replay(bag, "--out", out, "--bag", "-p", "publish_rate_hz:=5")
    assert done.status == 0, done.err
    document = json.loads((out / "result.json").read_text())
    first, *_, last = csv.DictReader((out / "estimates.csv").open())
    assert (first["odometer_scale_error"], first["lever_x_m"]) == ("", "")
    assert float(last["odometer_scale_error"]) == pytest.approx(0.012, abs=0.01)
    assert float(last["mounting_yaw_sigma_deg"]) > 0.0
    report = (out / "report.html").read_text()
    assert report.count("<svg") == 6
    assert "Odometer scale error [%]" in report and "Mounting [deg]" in report
    with open_bag([out / "aligned.mcap"]) as aligned:
        attitudes = [message for _, message in aligned.read_messages("/odo_align/attitude")]
        mountings = [message for _, message in aligned.read_messages("/odo_align/mounting")]
        assert "/odo_align/lever_arm" not in aligned.topics
    q = attitudes[-1].orientation
    assert [q.w, q.x, q.y, q.z] == pytest.approx(document["q_nb_wxyz"], abs=1e-6)
    # No heading is claimed before it deserves the name.
    assert all(message.orientation_covariance[8] < math.radians(3.0) ** 2 for message in attitudes)
    position = mountings[-1].pose.pose.position
    lever_arm = document["odometer_lever_arm_m"]
    assert [position.x, position.y, position.z] == pytest.approx(lever_arm, abs=0.05)


def test_types_and_storages_give_the_same(
    replay: Any, make_bag: MakeBag, drive: VehicleRun
) -> None:
    stamps, speed, _ = drive.odometer
    untold = OdometerSamples(stamps, speed, np.zeros_like(speed))
    documents = [
        replay(make_bag(("/odom", kind, untold, stamps), storage=storage), "--json", "-").document
        for kind, storage in zip(KINDS["odom"], ("mcap", "sqlite3", "mcap"), strict=True)
    ]
    assert documents[0]["q_nb_wxyz"] is not None
    assert documents[0] == documents[1] == documents[2]
    # A covariance is used where the message has one.
    told = replay(make_bag(("/odom", KINDS["odom"][2], drive.odometer, stamps)), "--json", "-")
    assert told.document["q_nb_wxyz"] != documents[0]["q_nb_wxyz"]


def test_it_does_not_matter_when_the_odometer_comes_within_the_timeout(
    replay: Any, make_bag: MakeBag, drive: VehicleRun
) -> None:
    stamps = drive.odometer.stamp_ns
    early, prompt, late, too_late = (
        replay(make_bag(("/odom", TWIST, drive.odometer, stamps + delay)), "--json", "-").document
        for delay in (-SECOND, 0, SECOND, 5 * SECOND)
    )
    assert prompt["input"]["odom_samples"] == len(stamps)
    assert early == prompt == late
    assert (too_late["state"], too_late["q_nb_wxyz"]) == ("waiting", None)


def test_a_part_of_the_bag(replay: Any, bag: Path, drive: VehicleRun) -> None:
    done = replay(bag, "--start", 20, "--duration", 60, "--json", "-")
    stamps = drive.odometer.stamp_ns
    begin = drive.imu.stamp_ns[0] + 20 * SECOND
    inside = int(((stamps >= begin) & (stamps < begin + 60 * SECOND)).sum())
    assert done.document["input"]["imu_samples"] == 3000
    assert done.document["input"]["odom_samples"] == inside
    assert done.document["input"]["odom_rejected"] == 0


def test_values_that_cannot_be_are_refused_and_counted(
    replay: Any, make_bag: MakeBag, drive: VehicleRun
) -> None:
    stamps, speed, variance = drive.odometer
    speed = speed.copy()
    speed[[100, 101]], speed[500] = (math.nan, math.inf), 1e4
    bag = make_bag(("/odom", TWIST, OdometerSamples(stamps, speed, variance), stamps))
    done = replay(bag, "--json", "-")
    counts = done.document["input"]
    assert (counts["odom_samples"], counts["odom_rejected"]) == (len(stamps) - 3, 3)
    assert done.status == 0


def test_a_silent_odometer_is_said_and_nothing_is_claimed(
    replay: Any, make_bag: MakeBag, drive: VehicleRun
) -> None:
    few = drive.odometer.select(slice(0, 1))
    done = replay(make_bag(("/odom", TWIST, few, few.stamp_ns)))
    assert done.status == 3
    assert "no odometer" in done.out.splitlines()[0]


def test_the_topic_is_found_or_named(
    replay: Any, make_bag: MakeBag, drive: VehicleRun, bag: Path
) -> None:
    stamps = drive.odometer.stamp_ns
    wheel = ("/wheel", KINDS["odom"][1], drive.odometer, stamps)
    other = ("/other", KINDS["odom"][2], drive.odometer.select(slice(0, 9)), stamps[:9])
    two = make_bag(wheel, other)
    chosen = replay(two, "--odom-topic", "wheel", "--json", "-")
    assert chosen.document == replay(bag, "--json", "-").document
    for words, says in (
        ([two], ["several topics", "/other, /wheel"]),
        ([two, "--odom-topic", "/imu"], ["no geometry_msgs/TwistStamped or", "/imu (sensor_msgs"]),
        ([two, "--odom-topic", "/gone"], ["/gone", "/wheel (geometry_msgs"]),
        ([make_bag()], ["no topic of geometry_msgs/TwistStamped or", "/imu (sensor_msgs/Imu)"]),
    ):
        done = replay(*words)
        assert (done.status, done.out) == (2, "")
        (line,) = done.err.splitlines()
        assert all(text in line for text in says), line


def test_a_standing_vehicle_needs_no_odometer(replay: Any, tmp_path: Path) -> None:
    run = simulate_vehicle(VehicleOptions(scenario="static", seed=5, rate_hz=50.0, duration_s=90.0))
    with BagWriter(tmp_path / "standing") as bag:
        bag.write_imu(run.imu)
    words = ["-p", "aiding:=stationary", "--json", "-"]
    done = replay(tmp_path / "standing", *words)
    assert done.status == 0, done.err
    document = done.document
    error = math.remainder(document["heading_deg"] - math.degrees(run.truth.heading_at(
        run.truth.stamp_ns)), 360.0)  # fmt: skip
    assert abs(error) * 60.0 < 4.0 * document["sigma_arcmin"]["heading"]
    assert document["odometer_scale_error"] is None
    assert document["input"]["odom_samples"] == 0
