"""An estimate whose sigma is not to be believed is not aligned."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from completed_estimates import (
    DECLARED,
    ODOMETER,
    aligned_completer,
    estimate,
    expecting,
    having,
    status_of,
)
from scipy.stats import chi2

from sins_align.consistency import RARE_GYRO_BIAS, Declared
from sins_align.types import Advance, State, Witness
from sins_align.units import ARCMIN


@pytest.mark.parametrize("what", ["heading", "east", "north"])
def test_not_a_number_is_never_aligned(what: str) -> None:
    status = status_of(estimate(**{what: math.nan}))
    assert status.state in (State.COARSE, State.FINE)
    assert status.reason
    assert status.aligned_at_s is None
    held = aligned_completer().update(Advance(0, estimate(**{what: math.nan})), 11.0)
    assert held.state in (State.COARSE, State.FINE)


def test_innovations_that_do_not_fit_are_not_aligned() -> None:
    unknown = status_of(having(consistency=math.nan))  # without an innovation yet
    assert unknown.state is State.FINE and unknown.keys == ("unproven",)
    status = status_of(dataclasses.replace(estimate(), consistency=2.5))
    assert status.state is State.FINE
    assert "2.5 times" in status.reason and "imu_grade" in status.remedy
    # A base that is stiller than declared.
    assert status_of(having(consistency=0.01)).state is State.ALIGNED


def test_an_attitude_that_changes_too_much_is_not_aligned() -> None:
    """Heading has changed by 5 sigma of what it may."""
    assert status_of(having(steadiness=15.9)).state is State.ALIGNED
    status = status_of(having(steadiness=25.0))
    assert (status.state, status.keys) == (State.FINE, ("unsteady",))
    assert "changed by 5.0 times the sigma" in status.reason
    assert "gyro_arw_deg_sqrt_h" in status.remedy
    assert status_of(having(steadiness=math.nan)).keys == ("unproven",)
    assert status_of(having(steadiness=None)).state is State.ALIGNED


def test_a_bias_beyond_the_declared_one_is_not_aligned() -> None:
    found = having(gyro_bias=np.array([0.0, -6e-6, 0.0]))
    assert status_of(found, expecting(declared=Declared(2e-6))).state is State.ALIGNED
    status = status_of(found, expecting(declared=Declared(1e-6)))
    assert status.state is State.FINE
    assert "gyro bias is 6.0 times" in status.reason


@pytest.mark.parametrize("told", [1, 2, 3])
def test_of_fewer_components_a_shorter_gyro_bias_is_doubted(told: int) -> None:
    """The bound is of chi-square with as many degrees of freedom as the data tell."""
    sigma = np.where(np.arange(3) < told, 0.0, 1e-6)
    bound = 1e-6 * math.sqrt(chi2.isf(RARE_GYRO_BIAS, told))
    for k, state in ((0.99, State.ALIGNED), (1.01, State.FINE)):
        found = having(gyro_bias=np.array([k * bound, 0.0, 0.0]), gyro_bias_sigma=sigma)
        assert status_of(found, expecting(declared=Declared(1e-6))).state is state


def test_an_accelerometer_bias_beyond_the_declared_one_is_not_aligned() -> None:
    level = having(accel_bias=np.array([6e-3, 0.0, 0.0]))
    upward = having(accel_bias=np.array([0.0, 0.0, 6e-3]))
    declared = expecting(declared=Declared(accel_bias=1e-3))
    status = status_of(level, declared)
    assert status.state is State.FINE and "accelerometer bias is 6.0 times" in status.reason
    assert status_of(upward, declared).state is State.ALIGNED
    assert status_of(level).state is State.ALIGNED


def test_a_scale_error_beyond_the_declared_one_is_not_aligned() -> None:
    """km/h for m/s, say."""
    found = having(odometer=dataclasses.replace(ODOMETER, scale_error=0.3))
    status = status_of(found, expecting(declared=Declared(odometer_scale=0.02)))
    assert status.state is State.FINE and "scale error is 15.0 times" in status.reason
    wide = expecting(declared=Declared(odometer_scale=0.1))
    assert status_of(found, wide).state is State.ALIGNED


@pytest.mark.parametrize("square", [1.1, 100.0, math.nan])
def test_a_witness_that_says_otherwise(square: float) -> None:
    """Two filters on the same data that differ as if they were independent: one of them lies."""
    phi = np.array([0.0, 0.0, -4.0 * ARCMIN])
    status = status_of(having(witness=Witness("wander_kf", phi, square)))
    assert status.state is State.FINE
    assert "wander_kf beside it differs by 4.0' in heading" in status.reason


def test_a_witness_that_agrees() -> None:
    witness = Witness("wander_kf", np.array([0.0, 0.0, 4.0 * ARCMIN]), 0.9)
    assert status_of(having(witness=witness)).state is State.ALIGNED


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("what", ["gyro_bias", "accel_bias"])
def test_a_bias_that_is_no_number_is_in_doubt(what: str, axis: int) -> None:
    bias = np.zeros(3)
    bias[axis] = math.nan
    assert status_of(having(**{what: bias}), expecting(declared=DECLARED)).keys == ("bias_beyond",)
