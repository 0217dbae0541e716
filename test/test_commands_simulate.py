"""The command `align_simulate`."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags")

from sins_align.ros import simulate_command
from sins_align.ros.bags import open_bag
from sins_align.ros.simulation_options import SIMULATIONS
from sins_align.simulate import (
    SwingOptions,
    VehicleOptions,
    simulate_swing,
    simulate_vehicle,
)

SHORT = ["swing", "--rate", "50", "--duration", "3"]
SHORT_ODO = ["odo", "--scenario", "moving_start", "--rate", "50", "--duration", "20"]
ODOM_TYPES = ("TwistStamped", "TwistWithCovarianceStamped", "Odometry")


@pytest.fixture
def simulate(capfd: pytest.CaptureFixture[str]) -> Any:
    def run(*words: object) -> tuple[int, str, str]:
        try:
            status = simulate_command.main([str(word) for word in words])
        except SystemExit as leaving:  # argparse
            status = int(leaving.code or 0)
        return status, *capfd.readouterr()

    return run


def test_bag_and_truth(simulate: Any, tmp_path: Path) -> None:
    out = tmp_path / "bag"
    options = ["--grade", "fog", "--seed", 7, "--lever-arm", 1, -2, 3, "--latitude-deg", -33]
    status, said, complaint = simulate(*SHORT, *options, "--out", out)
    assert (status, complaint) == (0, "")
    assert str(out) in said
    expected = simulate_swing(
        SwingOptions(
            grade="fog", seed=7, rate_hz=50.0, duration_s=3.0, lever_arm_m=(1.0, -2.0, 3.0),
            latitude_deg=-33.0,
        )
    )  # fmt: skip
    with open_bag([out]) as bag:
        (samples,) = bag.read_imu("/imu")
        position = bag.read_fix("/fix")
    for found, made in zip(samples, expected.imu, strict=True):
        np.testing.assert_array_equal(found, made)
    assert position is not None
    assert np.degrees(position.latitude) == pytest.approx(-33.0)
    assert json.loads((out / "truth.json").read_text()) == expected.truth.truth_dict()


def test_bag_of_a_swing_that_drives_off(simulate: Any, tmp_path: Path) -> None:
    out = tmp_path / "bag"
    options = [
        "--drive-m", 20, "--drive-start", 0.5, "--drive-duration", 2, "--drive-azimuth-deg", 40,
        "--drive-shake-m-s2", 0.3,
    ]  # fmt: skip
    assert simulate(*SHORT, *options, "--out", out)[0] == 0
    expected = simulate_swing(
        SwingOptions(
            grade="rlg", rate_hz=50.0, duration_s=3.0, drive_m=20.0, drive_start_s=0.5,
            drive_duration_s=2.0, drive_azimuth_deg=40.0, drive_shake_m_s2=0.3,
        )
    )  # fmt: skip
    with open_bag([out]) as bag:
        (samples,) = bag.read_imu("/imu")
    np.testing.assert_array_equal(samples.f_ib_b, expected.imu.f_ib_b)
    begin, end = json.loads((out / "truth.json").read_text())["drive_stamp_ns"]
    assert (begin - samples.stamp_ns[0], end - begin) == (500_000_000, 2_000_000_000)


@pytest.mark.parametrize("odom_type", ODOM_TYPES)
@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_bag_of_a_vehicle(simulate: Any, tmp_path: Path, odom_type: str, storage: str) -> None:
    out = tmp_path / "bag"
    options = [
        "--seed", 3, "--odometer-rate-hz", 7, "--odometer-report-variance", "--storage", storage,
        "--odometer-latency", 0.3, "--dropouts", 4, 2, 9, 1.5, "--scale-step", 8, 0.02,
        "--mounting-rpy-deg", 0, -0.3, 0.3, "--odom-type", odom_type,
    ]  # fmt: skip
    status, _, complaint = simulate(*SHORT_ODO, *options, "--out", out)
    assert (status, complaint) == (0, "")
    expected = simulate_vehicle(
        VehicleOptions(
            scenario="moving_start", seed=3, rate_hz=50.0, duration_s=20.0,
            odometer_rate_hz=7.0, odometer_report_variance=True, odometer_latency_s=0.3,
            dropouts=((4.0, 2.0), (9.0, 1.5)), scale_step=(8.0, 0.02),
            mounting_rpy_deg=(0.0, -0.3, 0.3),
        )
    )  # fmt: skip
    with open_bag([out]) as bag:
        (imu,) = bag.read_imu("/imu")
        topic = bag.find_topic("odom")
        recording = bag.read_odometer(topic.name)
        assert bag.read_fix("/fix") is not None
    assert (topic.name, topic.type.rpartition("/")[2]) == ("/odom", odom_type)
    for found, made in zip(imu, expected.imu, strict=True):
        np.testing.assert_array_equal(found, made)
    stamp_ns, speed, variance = expected.odometer
    np.testing.assert_array_equal(recording.samples.stamp_ns, stamp_ns)
    np.testing.assert_array_equal(recording.log_time, stamp_ns)
    np.testing.assert_array_equal(recording.samples.speed, speed)
    known = 0.0 if odom_type == "TwistStamped" else variance
    np.testing.assert_array_equal(recording.samples.variance, known)
    assert (variance > 0.0).all() and 60 < len(recording.samples) < 7 * 20 - 7 * 3.5 + 2
    truth = json.loads((out / "truth.json").read_text())
    assert truth == expected.truth.truth_dict()
    assert truth["odometer_latency_s"] == 0.3


@pytest.mark.parametrize(
    ("kind", "defaults", "without"),
    [
        ("swing", SwingOptions(grade="rlg"), {"start_stamp_ns"}),
        ("odo", VehicleOptions(), {"start_stamp_ns"}),
    ],
)
def test_every_setting_of_the_simulator_is_an_option(
    kind: str, defaults: Any, without: set[str]
) -> None:
    simulation = SIMULATIONS[kind]
    values = {name: entry.default for name, entry in simulation.parameters.items()}
    assert simulation.options(values) == defaults
    fields = {field.name for field in dataclasses.fields(defaults)}
    assert set(simulation.table) == fields - without


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ([], "required"),
        (["fly", "--out", "OUT"], "fly"),
        ([*SHORT_ODO, "--out", "OUT", "--scenario", "pitch"], "figure8"),
        ([*SHORT_ODO, "--out", "OUT", "--odom-type", "Twist"], "TwistWithCovarianceStamped"),
        ([*SHORT_ODO, "--out", "OUT", "--dropouts", "1", "2", "3"], "dropouts"),
        ([*SHORT_ODO, "--out", "OUT", "--stuck", "1", "-2"], "stuck"),
        ([*SHORT_ODO, "--out", "OUT", "--odometer-clock-drift", "1"], "odometer_clock_drift"),
        ([*SHORT_ODO, "--out", "OUT", "--latitude-deg", "89.96"], "latitude_deg"),
        ([*SHORT_ODO, "--out", "OUT", "--outlier-fraction", "2"], "outlier_fraction"),
        (["swing"], "--out"),
        ([*SHORT, "--out", "OUT", "--scenario", "storm"], "pitch, erect"),
        ([*SHORT, "--out", "OUT", "--grade", "gold"], "tactical"),
        ([*SHORT, "--out", "OUT", "--latitude-deg", "91"], "latitude_deg"),
        ([*SHORT, "--out", "OUT", "--seed", "1.5"], "seed"),
        (["swing", "--rate", "1e5", "--duration", "1e6", "--out", "OUT"], "1e+11 samples"),
        ([*SHORT, "--out", "OUT", "--jitter", "0.5"], "stamp_jitter_s"),
        ([*SHORT, "--out", "OUT", "--drive-m", "10"], "drive_start_s"),
        ([*SHORT, "--out", "OUT", "--drive-m", "2000"], "drive_m"),
        ([*SHORT, "--out", "OUT", "--drive-shake-m-s2", "-1"], "drive_shake_m_s2"),
        ([*SHORT, "--out", "OUT", "--storage", "tape"], "tape"),
        ([*SHORT, "--out", "."], "exists"),
        ([*SHORT, "--out", "/dev/null/x"], "/dev/null/x"),
    ],
)
def test_unusable_is_one_line_and_status_2(
    simulate: Any, tmp_path: Path, words: list[str], says: str
) -> None:
    out = tmp_path / "out"
    status, said, complaint = simulate(*(word.replace("OUT", str(out)) for word in words))
    assert (status, said) == (2, "")
    (line,) = complaint.splitlines()
    assert says in line
    assert not out.exists()
