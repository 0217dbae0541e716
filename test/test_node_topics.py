"""The node `swing_align` from outside: topics, QoS, services, and the numbers of a replay."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

pytest.importorskip("rclpy")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped
from node_harness import (
    KEYS,
    LATCHED,
    RELIABLE,
    SWING,
    SYNTH,
    TEXTS,
    Observer,
    arguments,
    diagnostic_values,
    observing,
    run_module,
    running,
    stamp_ns,
    stop,
)
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from sensor_msgs.msg import Imu
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from sins_align.rotation import dcm_from_quaternion, log_rotation

pytestmark = [pytest.mark.ros, pytest.mark.slow]

LEVER_KEYS = {
    "lever_x_m", "lever_y_m", "lever_z_m", "lever_x_sigma_m", "lever_y_sigma_m", "lever_z_sigma_m"
}  # fmt: skip

SIMULATION = {"scenario": "pitch", "grade": "rlg", "seed": 3, "rate": 100.0, "duration_s": 60.0}
ALIGNMENT = {
    "latitude_deg": 40.0, "longitude_deg": 116.0, "altitude_m": 50.0,
    "heading_threshold_arcmin": 20.0, "level_threshold_arcsec": 60.0, "hold_s": 2.0,
}  # fmt: skip
PUBLISH_RATE_HZ = 10


class Run(NamedTuple):
    """A node that has seen everything a simulation has, and still runs."""

    observer: Observer
    process: Any
    result: Path
    truth: dict[str, Any]
    received: dict[str, list[Any]]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Run]:
    folder = tmp_path_factory.mktemp("run")
    result = folder / "result.json"
    node = {**ALIGNMENT, "publish_rate_hz": float(PUBLISH_RATE_HZ), "result_file": result}
    synth = {**SIMULATION, "speed": 0.0, "truth_file": folder / "truth.json"}
    with observing() as observer:
        for message_type, topic, qos in (
            (Imu, "/swing_align/attitude", RELIABLE),
            (PoseWithCovarianceStamped, "/swing_align/misalignment", RELIABLE),
            (PoseWithCovarianceStamped, "/swing_align/lever_arm", RELIABLE),
            (Bool, "/swing_align/aligned", LATCHED),
            (DiagnosticArray, "/diagnostics", RELIABLE),
        ):
            observer.listen(message_type, topic, qos)
        with running(SWING, *arguments(node), log=folder / "node.log") as process:
            # Sees the node idle before the first sample comes.
            observer.wait(observer.diagnostics, "diagnostics")
            observer.wait(lambda: observer.received["/swing_align/aligned"], "aligned")
            observer.introduce("swing_align")
            with running(SYNTH, *arguments(synth), log=folder / "synth.log") as player:
                observer.wait(lambda: player.poll() is not None, "the end of align_synth")
                assert player.returncode == 0, (folder / "synth.log").read_text()
            truth = json.loads((folder / "truth.json").read_text())
            for name in ("attitude", "misalignment"):
                observer.wait_for_stamp(f"/swing_align/{name}", truth["stamp_ns"])
            observer.wait(lambda: observer.state == "aligned", "the state aligned")
            yield Run(observer, process, result, truth, observer.received)


def test_attitude_meets_the_truth_within_its_covariance(run: Run) -> None:
    last = run.received["/swing_align/attitude"][-1]
    assert stamp_ns(last) == run.truth["stamp_ns"]
    q = last.orientation
    C_nb = dcm_from_quaternion(np.array([q.w, q.x, q.y, q.z]))
    phi = -log_rotation(C_nb @ dcm_from_quaternion(np.array(run.truth["q_nb_wxyz"])).T)
    covariance = last.orientation_covariance.reshape(3, 3)
    assert (np.abs(phi) < 4.0 * np.sqrt(np.diag(covariance))).all()
    assert math.degrees(np.linalg.norm(phi)) < 0.3
    assert last.header.frame_id == "imu"


def test_attitude_is_on_the_grid_of_stamps(run: Run) -> None:
    attitude = run.received["/swing_align/attitude"]
    stamps = np.array([stamp_ns(message) for message in attitude])
    assert (stamps % (1_000_000_000 // PUBLISH_RATE_HZ) == 0).all()
    assert (np.diff(stamps) == 1_000_000_000 // PUBLISH_RATE_HZ).all()
    # There is a coarse attitude within 30 s.
    assert stamps[0] <= run.truth["stamp_ns"] - 30_000_000_000
    for message in attitude:
        numbers = [*message.orientation_covariance, message.orientation.w]
        numbers += [message.angular_velocity.x, message.linear_acceleration.z]
        assert np.isfinite(numbers).all()


def test_misalignment_carries_the_same_covariance(run: Run) -> None:
    attitude, pose = (
        run.received[f"/swing_align/{name}"][-1] for name in ("attitude", "misalignment")
    )
    covariance = pose.pose.covariance.reshape(6, 6)
    assert pose.header.frame_id == "map"
    assert pose.header.stamp == attitude.header.stamp
    assert pose.pose.pose.orientation == attitude.orientation
    np.testing.assert_array_equal(covariance[3:, 3:].ravel(), attitude.orientation_covariance)
    assert not covariance[:3].any() and not covariance[:, :3].any()


def test_aligned_goes_from_false_to_true(run: Run) -> None:
    assert [message.data for message in run.received["/swing_align/aligned"]] == [False, True]


def test_late_joiner_gets_lever_arm_and_aligned(run: Run) -> None:
    observer = run.observer
    observer.listen(PoseWithCovarianceStamped, "/swing_align/lever_arm", LATCHED, "late lever")
    observer.listen(Bool, "/swing_align/aligned", LATCHED, "late aligned")
    observer.wait(lambda: observer.received["late lever"], "the lever arm")
    observer.wait(lambda: observer.received["late aligned"], "aligned")
    assert observer.received["late aligned"][0].data is True
    message = observer.received["late lever"][0]
    position = message.pose.pose.position
    error = np.array([position.x, position.y, position.z]) - run.truth["lever_arm_m"]
    sigma = np.sqrt(np.diag(message.pose.covariance.reshape(6, 6)))[:3]
    assert (np.abs(error) < 4.0 * sigma).all()
    assert message.header.frame_id == "imu"


def test_diagnostics_say_everything_every_time(run: Run) -> None:
    seen = run.received["/diagnostics"]
    for message in seen:
        (status,) = message.status
        found = diagnostic_values(message)
        assert set(found) == KEYS | LEVER_KEYS
        for key in set(found) - TEXTS:
            assert re.fullmatch(r"unknown|-?\d+(\.\d+)?", found[key]), (key, found[key])
        assert bool(found["reason"]) == (status.level != DiagnosticStatus.OK)
    first, last = seen[0], seen[-1]
    assert first.status[0].level == DiagnosticStatus.ERROR
    assert diagnostic_values(first)["state"] == "waiting"
    assert diagnostic_values(first)["sigma_heading_arcmin"] == "unknown"
    assert diagnostic_values(last)["imu_rejected"] == "0"
    assert float(diagnostic_values(last)["imu_rate_hz"]) == pytest.approx(100.0)


def test_silence_becomes_an_error(run: Run) -> None:
    def silent() -> bool:
        status = run.observer.received["/diagnostics"][-1].status[0]
        return status.level == DiagnosticStatus.ERROR and "no usable IMU data" in status.message

    run.observer.wait(silent, "the error of silence")


def test_qos_is_that_of_the_interface(run: Run) -> None:
    for topic, reliability, durability in (
        ("/imu", ReliabilityPolicy.BEST_EFFORT, DurabilityPolicy.VOLATILE),
        ("/fix", ReliabilityPolicy.BEST_EFFORT, DurabilityPolicy.VOLATILE),
        ("/swing_align/attitude", ReliabilityPolicy.RELIABLE, DurabilityPolicy.VOLATILE),
        ("/swing_align/misalignment", ReliabilityPolicy.RELIABLE, DurabilityPolicy.VOLATILE),
        ("/swing_align/lever_arm", ReliabilityPolicy.RELIABLE, DurabilityPolicy.TRANSIENT_LOCAL),
        ("/swing_align/aligned", ReliabilityPolicy.RELIABLE, DurabilityPolicy.TRANSIENT_LOCAL),
        ("/diagnostics", ReliabilityPolicy.RELIABLE, DurabilityPolicy.VOLATILE),
    ):
        profile = run.observer.profile("swing_align", topic)
        assert profile.reliability == reliability, topic
        assert profile.durability == durability, topic


def test_live_and_replay_are_bit_identical(run: Run, tmp_path: Path) -> None:
    assert run.observer.call(Trigger, "/swing_align/save").success
    live = json.loads(run.result.read_text())
    options = [word for name, value in SIMULATION.items()
               for word in (f"--{name.removesuffix('_s')}", str(value))]  # fmt: skip
    made = run_module(
        "sins_align.ros.simulate_command", "swing", *options, "--out", str(tmp_path / "bag")
    )
    assert made.returncode == 0, made.stderr
    overrides = [word for name, value in ALIGNMENT.items() for word in ("-p", f"{name}:={value}")]
    replayed = run_module(
        "sins_align.ros.replay_command", "swing", str(tmp_path / "bag"), "--json", "-", *overrides
    )
    assert replayed.returncode == 0, replayed.stderr
    replay = json.loads(replayed.stdout)
    assert live["input"]["imu_samples"] == 6001
    for document in (live, replay):
        del document["timing"]
    assert live == replay


# The last two tests: they end what the others look at.


def test_restart_forgets_everything(run: Run) -> None:
    aligned = run.received["/swing_align/aligned"]
    assert run.observer.call(Trigger, "/swing_align/restart").success
    run.observer.wait(lambda: not aligned[-1].data, "aligned to become false")
    run.observer.wait(lambda: run.observer.state == "waiting", "the state waiting")
    assert run.observer.diagnostics()["sigma_heading_arcmin"] == "unknown"


def test_sigint_ends_with_the_result_written(run: Run) -> None:
    run.result.unlink()
    assert stop(run.process) == 0
    document = json.loads(run.result.read_text())
    assert (document["state"], document["q_nb_wxyz"]) == ("waiting", None)
