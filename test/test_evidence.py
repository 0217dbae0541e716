"""What `make evidence` judges by: a bound that is not kept must not pass for one that is."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from evidence import odo, odo_data, odo_paper, swing
from evidence.checks import Check, upper
from evidence.odo_runs import (
    Start,
    below_since,
    divergence,
    drive,
    false_claims,
    heading_errors,
    make_config,
    nees,
    rows,
)
from sins_align.session import Update
from sins_align.simulate import VehicleOptions
from sins_align.types import Estimate, State, Status
from sins_align.units import ARCMIN

RUN = Path(__file__).resolve().parent.parent / "evidence" / "run.py"
SECTIONS = (*swing.SECTIONS, *odo.SECTIONS, *odo_paper.SECTIONS, *odo_data.SECTIONS)


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
    drives = [drive(options, None, Start(-125.0)), drive(options)]
    errors = heading_errors(drives)
    assert errors.shape == (2, 41)
    assert np.isnan(errors[:, 0]).all()
    assert np.abs(errors[:, -1]).max() < 120.0
    assert nees(drives, 40) < 9.0
    assert all(check.kept for check in divergence(drives))
    assert len(rows(drives, (30, 40, 600))) == 4
    assert drives[0].scale_error[-1] == pytest.approx(drives[1].scale_error[-1])
    # The paper's filter begins with the heading that it is given, and believes it so far.
    wrong = drive(options, None, Start(-60.0, 0.1))
    assert wrong.phi[5, 2] / ARCMIN == pytest.approx(-3600.0, abs=30.0)


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
