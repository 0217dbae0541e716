"""What `make evidence` judges by: a bound that is not kept must not pass for one that is."""

from __future__ import annotations

import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from evidence import odo, odo_data, odo_methods, odo_paper, status, swing
from evidence.checks import Check, upper
from evidence.odo_figures import below_since, divergence, heading_errors, nees, rows
from evidence.odo_recording import RecordedSession, Start
from evidence.odo_runs import drive, every_drive, false_claims, make_config
from sins_align.rotation import dcm_from_quaternion
from sins_align.simulate import VehicleOptions, simulate_vehicle
from sins_align.types import Estimate, State, Status, Update
from sins_align.units import ARCMIN

RUN = Path(__file__).resolve().parent.parent / "evidence" / "run.py"
SECTIONS = (
    *swing.SECTIONS,
    *odo.SECTIONS,
    *odo_methods.SECTIONS,
    *odo_paper.SECTIONS,
    *odo_data.SECTIONS,
    *status.SECTIONS,
)


@pytest.mark.parametrize(
    ("value", "kept"), [(1.0, True), (0.99, False), (2.0, True), (2.01, False), (math.nan, False)]
)
def test_check(value: float, kept: bool) -> None:
    check = Check("a figure", value, 1.0, 2.0)
    assert check.kept is kept
    assert ("BROKEN" in str(check)) is not kept


def test_a_magnitude_has_no_sign_and_must_exist() -> None:
    assert upper("", -1.0, 1.0).kept
    assert not upper("", -1.1, 1.0).kept
    assert not upper("", math.nan, 1.0).kept
    assert not upper("", math.inf, 1.0).kept


@pytest.mark.parametrize(
    ("curve", "since"),
    [([9.0, 3.0, 0.5, 0.5], 2.0), ([0.5, 3.0, 0.5], 2.0), ([0.5, 0.5], 0.0), ([0.5, 1.0], math.inf),
     ([math.nan, 0.5], 1.0), ([0.5, math.nan], math.inf)],
)  # fmt: skip
def test_below_since_is_for_good(curve: list[float], since: float) -> None:
    assert below_since(np.array(curve), 1.0) == since


def test_claims_above_the_threshold_are_seen() -> None:
    config = make_config(VehicleOptions(), {"heading_threshold_arcmin": 10.0})
    zero = np.zeros(3)
    for heading, state, wrong in (
        (9.0, State.ALIGNED, 0),
        (11.0, State.ALIGNED, 1),
        (11.0, State.FINE, 0),
    ):
        P = np.diag([1e-6, 1e-6, heading]) ** 2 * ARCMIN**2
        estimate = Estimate(0, np.array([1.0, 0.0, 0.0, 0.0]), P, zero, zero, zero, zero)
        assert false_claims([Update(0, estimate, Status(state))], config) == wrong


def test_a_drive_second_by_second() -> None:
    """From a wrong heading, which is gone; before the filter begins there is nothing."""
    options = VehicleOptions(scenario="static", rate_hz=50.0, duration_s=40.0)
    wander = {"method": "wander_kf"}
    drives = [drive(options, wander, Start(-125.0)), drive(options, wander)]
    errors = heading_errors(drives)
    assert errors.shape == (2, 41)
    assert np.isnan(errors[:, 0]).all()
    assert np.abs(errors[:, -1]).max() < 120.0
    assert nees(drives, 40) < 9.0
    assert all(check.kept for check in divergence(drives))
    assert len(rows(drives, (30, 40, 600))) == 4
    assert drives[0].scale_error[-1] == pytest.approx(drives[1].scale_error[-1])
    assert drives[0].aligned_s == math.inf
    # The paper's filter begins with the heading that it is given, and believes it so far.
    wrong = drive(options, wander, Start(-60.0, 0.1))
    assert wrong.phi[5, 2] / ARCMIN == pytest.approx(-3600.0, abs=30.0)


@pytest.mark.parametrize("method", ["sghf", "wander_kf"])
def test_moments_are_what_is_given_out(method: str) -> None:
    """Each update's estimate is its moment's, whichever filter has come to be in charge."""
    options = VehicleOptions(scenario="ring", rate_hz=50.0, duration_s=110.0)
    simulated = simulate_vehicle(options)
    recorded = RecordedSession(make_config(options, {"method": method}))
    recorded.add_odometer(simulated.odometer)
    updates = recorded.add_imu(simulated.imu)
    assert [m.stamp_ns for m in recorded.moments] == [u.stamp_ns for u in updates][
        -len(recorded.moments) :
    ]
    shown = [u.estimate for u in updates if u.estimate is not None]
    moments = [m for m in recorded.moments if m.published]
    assert len(shown) == len(moments) > 30
    for estimate, moment in zip(shown, moments, strict=True):
        assert (estimate.misalignment_covariance == moment.covariance).all()
        assert dcm_from_quaternion(estimate.q_nb) == pytest.approx(moment.C_nb, abs=1e-12)
        assert (estimate.gyro_bias == moment.gyro_bias).all()
        assert (estimate.accel_bias == moment.accel_bias).all()
        assert estimate.odometer is not None
        assert estimate.odometer.scale_error == moment.scale[0]
    assert {m.is_large for m in moments[-30:]} == {method == "sghf"}
    last = recorded.moments[-1]
    v_n = simulated.truth.v_n_at(last.stamp_ns)
    assert np.abs(v_n).max() > 2.0
    assert last.velocity == pytest.approx(v_n, abs=0.3)


def test_each_of_the_settings_has_the_drives_that_it_would_have_alone() -> None:
    options = VehicleOptions(scenario="ring", rate_hz=50.0, duration_s=70.0)
    settings = {name: {"method": name} for name in ("wander_kf", "wander_ekf")}
    runs = every_drive(options, settings, 2)
    assert [d.seed for d in runs["wander_ekf"]] == [0, 1]
    for name, parameters in settings.items():
        alone = drive(replace(options, seed=1), parameters)
        np.testing.assert_array_equal(runs[name][1].phi, alone.phi)


def test_sections_have_names_of_their_own_and_say_what_they_are() -> None:
    names = [section.__name__ for section in SECTIONS]
    assert len(set(names)) == len(names)
    assert all(section.__doc__ for section in SECTIONS)


def test_command_knows_its_sections() -> None:
    done = subprocess.run(
        [sys.executable, RUN, "--only", "nothing"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    for section in SECTIONS:
        assert section.__name__ in done.stderr
