"""Time that jumps: bags that are played in a loop, and a /clock that stands or goes back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy")

from builtin_interfaces.msg import Time
from node_harness import (
    LATCHED,
    ODO,
    RELIABLE,
    SWING,
    THRESHOLDS,
    Observer,
    Player,
    arguments,
    observing,
    pitching,
    running,
    stamp_ns,
    urban_drive,
)
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu
from std_msgs.msg import Bool

from sins_align.simulate import SwingOptions, simulate_swing
from sins_align.types import ImuSamples

pytestmark = [pytest.mark.ros, pytest.mark.slow]

RATE_HZ = 10


def listen(observer: Observer, node: str) -> None:
    observer.listen(Imu, f"/{node}/attitude", RELIABLE)
    observer.listen(Bool, f"/{node}/aligned", LATCHED)
    observer.listen_to_diagnostics()


def stamps_of(observer: Observer, node: str) -> np.ndarray:
    return np.array([stamp_ns(message) for message in observer.received[f"/{node}/attitude"]])


def joined(first: ImuSamples, second: ImuSamples) -> ImuSamples:
    return ImuSamples(*(np.concatenate(pair, axis=-1) for pair in zip(first, second, strict=True)))


def check_second_pass(observer: Observer, node: str, log: Path, imu: ImuSamples) -> None:
    """What must have come of two passes over the same samples, the first less the last three."""

    def aligned() -> list[bool]:
        return [message.data for message in observer.received[f"/{node}/aligned"]]

    last_ns = int(imu.stamp_ns[-1])
    observer.wait(lambda: aligned() == [False, True, False, True], "aligned, twice")
    observer.wait_for_stamp(f"/{node}/attitude", last_ns)
    stamps = stamps_of(observer, node)
    (jump,) = np.nonzero(np.diff(stamps) < 0)[0]
    first, second = stamps[: jump + 1], stamps[jump + 1 :]
    # Nothing of the old time after the jump, and the second pass gives what the first one gave.
    period = 1_000_000_000 // RATE_HZ
    for part in (first, second):
        assert (np.diff(part) == period).all()
    assert (first[-1], second[-1]) == (last_ns - period, last_ns)
    assert abs(first[0] - second[0]) <= 1_000_000_000
    text = log.read_text()
    assert text.count("the alignment began anew: the IMU's stamps jumped back by ") == 1
    assert "Traceback" not in text
    # Counted are those before it was clear that time had jumped.
    observer.wait(
        lambda: observer.diagnostics()["imu_rejected"] != "0", "the count of what was refused"
    )
    assert int(observer.diagnostics()["imu_rejected"]) < 0.01 * len(imu)


def test_a_looped_bag_begins_the_swing_alignment_anew(tmp_path: Path) -> None:
    imu = pitching(30.0)
    parameters = {
        **THRESHOLDS, "latitude_deg": 40.0, "imu_grade": "perfect", "publish_rate_hz": RATE_HZ
    }  # fmt: skip
    log = tmp_path / "log"
    with observing() as observer, running(SWING, *arguments(parameters), log=log):
        listen(observer, "swing_align")
        player = Player(observer)
        player.play(imu.select(slice(0, -100)))
        observer.wait(lambda: observer.state == "aligned", "the first alignment")
        # In one go: the last of the old time and the first of the new one are taken in together.
        player.play(joined(imu.select(slice(-100, -3)), imu.select(slice(0, 300))))
        observer.wait(lambda: observer.state == "coarse", "the state coarse")
        assert "stamps jumped back by 29.9 s" in observer.diagnostics()["reason"]
        player.play(imu.select(slice(300, None)))
        check_second_pass(observer, "swing_align", log, imu)


@pytest.mark.parametrize("lead", [50, -20])
def test_a_looped_drive_begins_anew_whichever_jumps_first(tmp_path: Path, lead: int) -> None:
    run = urban_drive()
    parameters = {
        **THRESHOLDS, "latitude_deg": 40.0, "imu_grade": "fog", "publish_rate_hz": RATE_HZ
    }  # fmt: skip
    log = tmp_path / "log"
    with observing() as observer, running(ODO, *arguments(parameters), log=log):
        listen(observer, "odo_align")
        player = Player(observer, "odo_align", odom_type="TwistStamped")
        player.play(run.imu.select(slice(0, -3)), run.odometer, lead)
        observer.wait(lambda: observer.state == "aligned", "the first alignment")
        player.play(run.imu, run.odometer, lead)
        check_second_pass(observer, "odo_align", log, run.imu)


@pytest.mark.parametrize("executor", ["single", "events"])
def test_a_clock_that_stands_or_jumps_back_holds_nothing_up(tmp_path: Path, executor: str) -> None:
    """With use_sim_time: what waits is taken in all the same, and diagnostics go on."""
    imu = simulate_swing(SwingOptions(scenario="still", rate_hz=20.0, duration_s=4.0)).imu
    parameters = {
        "use_sim_time": True, "executor": executor, "latitude_deg": 40.0,
        "publish_rate_hz": 0.1,  # an output would take in what waits; this is for a timer to do
    }  # fmt: skip
    with observing() as observer, running(SWING, *arguments(parameters), log=tmp_path / "log"):
        observer.listen_to_diagnostics()
        clock = observer.node.create_publisher(Clock, "/clock", 1)
        player = Player(observer)

        def diagnosed_at(second: int) -> int:
            clock.publish(Clock(clock=Time(sec=second)))
            return sum(
                message.header.stamp.sec == second for message in observer.received["/diagnostics"]
            )

        for number, second in enumerate((0, 1000, 400)):  # not begun, stands, has jumped back
            observer.wait(lambda: diagnosed_at(second) >= 2, f"diagnostics at {second} s")  # noqa: B023
            player.play(imu.select(slice(20 * number, 20 * (number + 1))))
        observer.wait(
            lambda: observer.diagnostics()["elapsed_s"] == "2.000", "three seconds of samples"
        )
