"""The result file: whole or not at all, and what is left standing at the end of a run."""

from __future__ import annotations

import functools
import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from sins_align.config import swing_config
from sins_align.ros.result_file import ResultFile
from sins_align.ros.whole_file import (
    LEFT_OVER_S,
    check_target,
    remove_leftovers,
    write_text_whole,
    write_whole,
)
from sins_align.session import Session
from sins_align.simulate import SwingOptions, simulate_swing
from sins_align.types import ImuSamples, State

ROOT = Path(__file__).resolve().parent.parent
SECOND = 1_000_000_000
# A long document and a short one in turn, again and again.
WRITER = """
import json, sys
from pathlib import Path
from sins_align.ros.whole_file import write_text_whole
count = 0
while True:
    count += 1
    size = 200_000 if count % 2 else 100
    write_text_whole(Path(sys.argv[1]), json.dumps({"count": count, "filler": "x" * size}))
"""


def test_a_file_is_whole_whenever_the_writer_is_killed(tmp_path: Path) -> None:
    target = tmp_path / "result.json"
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    chance = random.Random(5)
    for _ in range(25):
        target.unlink(missing_ok=True)
        process = subprocess.Popen([sys.executable, "-c", WRITER, str(target)], env=environment)
        try:
            while not target.exists():
                assert process.poll() is None
                time.sleep(0.001)
            time.sleep(chance.uniform(0.0, 0.02))
        finally:
            process.send_signal(signal.SIGKILL)
            process.wait()
        document = json.loads(target.read_text())
        assert len(document["filler"]) == (200_000 if document["count"] % 2 else 100)
    # Where a writer died in the middle, its file lies about; the next start removes it.
    left = [path for path in tmp_path.iterdir() if path != target]
    assert left
    for path in left:
        os.utime(path, (0.0, 0.0))
    remove_leftovers(target)
    assert list(tmp_path.iterdir()) == [target]


def test_only_old_files_of_this_very_target_are_removed(tmp_path: Path) -> None:
    names = [
        ".result.json.abcdef_1.part", ".result.json.abcdefg.part", ".result.json.abcdef_1",
        ".other.json.abcdef_1.part", "result.json.abcdef_1.part", ".result.json.ABCDEF_1.part",
    ]  # fmt: skip
    old = time.time() - 2.0 * LEFT_OVER_S
    for name in [*names, ".result.json.new_one1.part"]:
        (tmp_path / name).write_text("")
        if name in names:
            os.utime(tmp_path / name, (old, old))
    remove_leftovers(tmp_path / "result.json")
    left = {path.name for path in tmp_path.iterdir()}
    assert left == {*names[1:], ".result.json.new_one1.part"}
    remove_leftovers(tmp_path / "missing" / "result.json")  # nothing to do


def test_a_failure_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    target = tmp_path / "result.json"
    write_text_whole(target, "old")

    def fail(_: object) -> None:
        raise OSError(28, "No space left on device")

    with pytest.raises(OSError, match="No space") as caught:
        write_whole(target, fail)
    assert caught.value.filename == str(target)
    assert target.read_text() == "old"
    assert list(tmp_path.iterdir()) == [target]


def test_a_name_too_long_for_its_temporary_name_is_found_before_the_run(tmp_path: Path) -> None:
    target = tmp_path / ("r" * 245)
    target.write_text("")  # the name itself is possible
    with pytest.raises(OSError, match="too long"):
        check_target(target)


@functools.cache
def samples() -> ImuSamples:
    return simulate_swing(
        SwingOptions(scenario="pitch", grade="perfect", rate_hz=50.0, duration_s=25.0, seed=1)
    ).imu


def aligned_session() -> Session:
    session = Session(
        swing_config(
            {
                "latitude_deg": 40.0, "imu_grade": "perfect", "heading_threshold_arcmin": 90.0,
                "level_threshold_arcsec": 300.0, "hold_s": 2.0, "latitude_check": "off",
            }
        )
    )  # fmt: skip
    session.add_imu(samples())
    assert session.status.state is State.ALIGNED
    return session


def later(duration_s: float, by_s: float = 1000.0) -> ImuSamples:
    imu = samples()
    imu = imu.select(imu.stamp_ns <= imu.stamp_ns[0] + int(duration_s * SECOND))
    return ImuSamples(imu.stamp_ns + int(by_s * SECOND), imu.w_ib_b, imu.f_ib_b)


def read(path: Path) -> dict[str, object]:
    document: dict[str, object] = json.loads(path.read_text())
    return document


@pytest.mark.parametrize("anew_s", [0.0, 3.0, 14.0])
def test_a_complete_alignment_outlives_the_beginning_of_another(
    tmp_path: Path, anew_s: float
) -> None:
    """Begun anew by request, or by a jump of time until there is a coarse attitude."""
    target = tmp_path / "result.json"
    file, session = ResultFile("swing_align", str(target)), aligned_session()
    file.write(session)
    complete = read(target)
    assert complete["aligned"]
    if anew_s:
        session.add_imu(later(anew_s))
        assert session.restarts == 1
    else:
        session.restart()
    assert (session.estimate is not None) == (anew_s > 10.0)
    assert not file.write_last(session)
    assert read(target) == complete
    # What is asked for is done, and then there is nothing left to be kept.
    file.write(session)
    assert read(target)["aligned"] is False
    target.unlink()
    assert file.write_last(session)
    assert read(target)["aligned"] is False


def test_an_alignment_that_broke_down_is_nothing_to_put_in_its_place(tmp_path: Path) -> None:
    target = tmp_path / "result.json"
    file, session = ResultFile("swing_align", str(target)), aligned_session()
    file.write(session)
    last = samples()
    more = ImuSamples(
        last.stamp_ns[1:200] + 25 * SECOND, last.w_ib_b[:, 1:200], 0.1 * last.f_ib_b[:, 1:200]
    )
    session.add_imu(more)  # no longer in m/s^2
    assert (session.status.state, session.restarts) == (State.FAILED, 0)
    assert not file.write_last(session)
    assert read(target)["aligned"]
    # Nor are the beginnings of what came after it.
    again = later(14.0, 29.0)
    session.add_imu(again)
    assert session.estimate is not None and session.status.state is not State.ALIGNED
    assert not file.write_last(session)
    assert read(target)["aligned"]


def test_what_a_run_went_on_from_is_replaced_by_something_better_only(tmp_path: Path) -> None:
    target, link = tmp_path / "result.json", tmp_path / "link.json"
    earlier = {"aligned": True, "of": "another run"}
    target.write_text(json.dumps(earlier))
    link.symlink_to(target)
    coarse = aligned_session()
    coarse.restart()
    coarse.add_imu(later(14.0))
    assert coarse.estimate is not None
    for session in (Session(swing_config()), coarse):
        assert not ResultFile("swing_align", str(target), str(link)).write_last(session)
        assert read(target) == earlier
    other = ResultFile("swing_align", str(tmp_path / "other.json"), str(target))
    assert other.write_last(coarse)
    other.set_path(str(target))
    assert not other.write_last(coarse)
    # A file that is not there, an alignment, and what is asked for.
    file = ResultFile("swing_align", str(target), str(target))
    target.unlink()
    assert file.write_last(coarse)
    target.write_text(json.dumps(earlier))
    file = ResultFile("swing_align", str(target), str(target))
    file.write(coarse)
    assert read(target)["aligned"] is False
    assert file.write_last(coarse)  # now it is this run's
    target.write_text(json.dumps(earlier))
    file = ResultFile("swing_align", str(target), str(target))
    assert file.write_last(aligned_session())
    assert read(target)["stamp_ns"] == int(samples().stamp_ns[-1])


def test_the_last_word_is_written_where_it_is_one(tmp_path: Path) -> None:
    target, other = tmp_path / "result.json", tmp_path / "other.json"
    target.write_text('{"aligned": true, "of": "another run"}')
    file = ResultFile("swing_align", str(target))
    assert file.write_last(Session(swing_config()))  # an earlier run's is replaced
    assert read(target)["state"] == "waiting"
    # Complete again after the restart.
    session = aligned_session()
    file.write(session)
    session.add_imu(later(25.0))
    assert (session.status.state, session.restarts) == (State.ALIGNED, 1)
    assert file.write_last(session)
    assert read(target)["stamp_ns"] == int(later(25.0).stamp_ns[-1])
    # The same alignment, taken back: the file must not go on claiming it.
    completion = session.config.completion
    session.set_completion(type(completion)(1e-12, 1e-12, 0.0))
    session.add_imu(later(4.0, 1025.02))
    assert (session.status.state is not State.ALIGNED, session.restarts) == (True, 1)
    assert file.write_last(session)
    assert read(target)["aligned"] is False
    # Gone, or elsewhere: nothing is there to be kept.
    session = aligned_session()
    file.write(session)
    session.restart()
    target.unlink()
    assert file.write_last(session)
    file.write(aligned_session())
    file.set_path(str(other))
    assert file.write_last(session)
    assert (read(target)["aligned"], read(other)["aligned"]) == (True, False)
    file.set_path("")
    other.unlink()
    assert file.write_last(session)
    file.write(session)
    assert not other.exists()
