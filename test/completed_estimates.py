"""Estimates below their thresholds, and what becomes of them when they are held."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from sins_align.config import Completion
from sins_align.consistency import Declared
from sins_align.earth import EARTH_RATE, GRAVITY_EQUATOR
from sins_align.grades import ImuGrade
from sins_align.reasons import Finding
from sins_align.status import Completer, Expectation
from sins_align.types import Advance, Estimate, OdometerEstimate, Position, State, Status
from sins_align.units import ARCMIN, ARCSEC, DEG

HEADING, LEVEL, HOLD_S = 6.0 * ARCMIN, 30.0 * ARCSEC, 10.0
COMPLETION = Completion(HEADING, LEVEL, HOLD_S)
LATITUDE = 40.0 * DEG
POSITION = Position(LATITUDE)
PERFECT = Expectation(ImuGrade(), POSITION)
UNDECLARED = Declared()
BELOW = 0.99


def expecting(
    heading_limit: float = 0.0,
    level_limit: float = 0.0,
    declared: Declared = UNDECLARED,
    latitude_check: str = "off",
    motion: str = "turn the base by 90 deg or more",
) -> Expectation:
    """Of sensors that allow so much and no better, however long they stand [rad]."""
    gyro_bias = heading_limit * EARTH_RATE * math.cos(LATITUDE)
    grade = ImuGrade(gyro_bias=gyro_bias, accel_bias=level_limit * GRAVITY_EQUATOR)
    return Expectation(grade, POSITION, declared, latitude_check, motion)


def estimate(
    heading: float = BELOW * HEADING, east: float = BELOW * LEVEL, north: float = BELOW * LEVEL
) -> Estimate:
    nothing = np.zeros(3)
    return Estimate(
        stamp_ns=0,
        q_nb=np.array([1.0, 0.0, 0.0, 0.0]),
        misalignment_covariance=np.diag(np.square([east, north, heading])),
        gyro_bias=nothing,
        gyro_bias_sigma=nothing,
        accel_bias=nothing,
        accel_bias_sigma=nothing,
        consistency=1.0,
    )


def status_of(
    found: Estimate | None, expectation: Expectation = PERFECT, findings: tuple[Finding, ...] = ()
) -> Status:
    """Held long enough."""
    completer = Completer(COMPLETION, expectation)
    completer.update(Advance(0, found, findings), 1.0)
    return completer.update(Advance(0, found, findings), 1.0 + HOLD_S)


def aligned_completer(expectation: Expectation = PERFECT) -> Completer:
    """One that has been aligned since 10 s."""
    completer = Completer(COMPLETION, expectation)
    completer.update(Advance(0, estimate()), 0.0)
    assert completer.update(Advance(0, estimate()), HOLD_S).state is State.ALIGNED
    return completer


ODOMETER = OdometerEstimate(
    0.0, 0.01, 0.0, 0.1, np.zeros(3), np.eye(3), np.zeros(3), np.eye(3)
)  # fmt: skip
DECLARED = Declared(gyro_bias=1e-6, accel_bias=1e-3, odometer_scale=0.01)


def having(**changes: object) -> Estimate:
    return dataclasses.replace(estimate(), **changes)
