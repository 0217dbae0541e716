"""Whether an estimate is consistent: with its innovations, with itself, with what is declared.

What is not has a sigma that is not to be believed, however small it is.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from sins_align.reasons import (
    BIAS_BEYOND,
    INCONSISTENT,
    UNPROVEN,
    UNSTEADY,
    WITNESS_DIFFERS,
    Finding,
)
from sins_align.rotation import dcm_from_quaternion
from sins_align.types import Estimate
from sins_align.units import ARCMIN

# Mean normalised innovation squared over its expectation: beyond this a sigma is not believed.
# There is no lower bound: a base that stands stiller than declared gives 0.01, and sigma is then
# too large, which misleads nobody.
MAX_CONSISTENCY = 2.0
# Two estimates from the same data may differ by less than independent ones would: normalised square
# of the difference over its expectation for such.
MAX_DISAGREEMENT = 1.0
# Largest square of a change of heading over its variance, of some that are not independent.
MAX_UNSTEADINESS = 16.0
# A bias so many sigma beyond the declared one is no bias: the vehicle moves, or the grade lies.
MAX_BIAS_RATIO = 5.0
# So rarely is a true bias of the gyros as long as one that is doubted. What the data tell of it
# tells on the east one, too, which on a base that does not turn is an error of heading and no more.
RARE_GYRO_BIAS = 1e-3
LEAST_TOLD = 0.1  # components of it


class Declared(NamedTuple):
    """What is declared of the sensors, 1 sigma; 0: not estimated, or not declared.

    gyro_bias [rad/s], drift included; accel_bias [m/s^2], with the scale errors that gravity
    turns into one; odometer_scale [1]
    """

    gyro_bias: float = 0.0
    accel_bias: float = 0.0
    odometer_scale: float = 0.0


def find_doubts(estimate: Estimate, declared: Declared, widening: float) -> list[Finding]:
    """Why sigma is not to be believed; empty where it is.

    widening : of the bounds, by which an alignment that is complete is left later than entered
    """
    doubts = []
    consistency, steadiness = estimate.consistency, estimate.steadiness
    if consistency > MAX_CONSISTENCY * widening:
        doubts.append(INCONSISTENT(ratio=consistency))
    # Neither stays NaN: an innovation comes within seconds, solutions within a minute.
    if math.isnan(consistency) or (steadiness is not None and math.isnan(steadiness)):
        doubts.append(UNPROVEN())
    elif steadiness is not None and steadiness > MAX_UNSTEADINESS * widening:
        doubts.append(UNSTEADY(ratio=math.sqrt(steadiness)))
    witness = estimate.witness
    if witness is not None and not witness.square <= MAX_DISAGREEMENT * widening:
        heading, ratio = abs(float(witness.phi[2])) / ARCMIN, math.sqrt(witness.square)
        doubts.append(WITNESS_DIFFERS(name=witness.name, heading=heading, ratio=ratio))
    for what, ratio, most in _beyond(estimate, declared):
        if not ratio <= most * widening:
            doubts.append(BIAS_BEYOND(what=what, ratio=ratio))
    return doubts


def _beyond(estimate: Estimate, declared: Declared) -> Iterator[tuple[str, float, float]]:
    """Estimates over what is declared of them, and the most of that which is believed."""
    if declared.gyro_bias > 0.0:
        ratio = math.hypot(*estimate.gyro_bias.tolist()) / declared.gyro_bias
        # Of a bias that the data do not tell the estimate is zero: it does not count.
        told = 1.0 - np.minimum(estimate.gyro_bias_sigma / declared.gyro_bias, 1.0) ** 2
        most = math.sqrt(chdtri(max(float(told.sum()), LEAST_TOLD), RARE_GYRO_BIAS))
        yield "gyro bias", ratio, most
    if declared.accel_bias > 0.0:
        # Along up, it also stands for a height that is wrong.
        up = dcm_from_quaternion(estimate.q_nb)[2]
        level = estimate.accel_bias - (estimate.accel_bias @ up) * up
        ratio = math.hypot(*level.tolist()) / declared.accel_bias
        yield "accelerometer bias", ratio, MAX_BIAS_RATIO
    if estimate.odometer is not None and declared.odometer_scale > 0.0:
        ratio = abs(estimate.odometer.scale_error) / declared.odometer_scale
        yield "odometer scale error", ratio, MAX_BIAS_RATIO
