"""A swinging base with all its motions, and its differentiation by central differences."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from sins_align.simulate import SwingOptions
from sins_align.simulate.base_motion import BaseMotion
from sins_align.simulate.random_streams import random_streams
from sins_align.simulate.swing import swing_base
from sins_align.types import Array

# Errors of central differences of 8th order with steps of 30 ms: rounding 1e-16 / step for
# a first derivative of values near 1, 1e-15 / step^2 for a second one of metres.
RATE_TOLERANCE = 1e-13
ACCELERATION_TOLERANCE = 1e-13
FORCE_TOLERANCE = 5e-11

STEP = 0.03
FIRST = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0, 4 / 5, -1 / 5, 4 / 105, -1 / 280])
SECOND = np.array([-1 / 560, 8 / 315, -1 / 5, 8 / 5, -205 / 72, 8 / 5, -1 / 5, 8 / 315, -1 / 560])

BUSY = SwingOptions(
    scenario="pitch",
    grade="perfect",
    seed=3,
    duration_s=60.0,
    latitude_deg=35.0,
    heading_deg=100.0,
    turn_deg=-150.0,
    turn_start_s=20.0,
    turn_duration_s=20.0,
    heave_m=0.3,
    sway_m=0.2,
    sway_azimuth_deg=30.0,
    lever_arm_m=(1.0, -2.0, 3.0),
)
# A drive whose greatest acceleration is 3 m/s^2, over the end of the turn.
DRIVE = {
    "drive_m": 100.0,
    "drive_start_s": 32.003,
    "drive_duration_s": 16.0,
    "drive_azimuth_deg": 70.0,
}


def base_of(options: SwingOptions) -> BaseMotion:
    return swing_base(options, random_streams(options.seed))


def stencil(t: Array) -> Array:
    """(9 N,) the times of a central difference around each of t (N,)."""
    return (t + STEP * np.arange(-4, 5)[:, np.newaxis]).ravel()


def differentiate(values: Array, weights: Array, order: int) -> Array:
    """(..., N) derivative of the values (..., 9 N) at the stencil."""
    return np.einsum("k,...kn->...n", weights, values.reshape(*values.shape[:-1], 9, -1)) / (
        STEP**order
    )


def earth_turn(base: BaseMotion, t: Array) -> Array:
    """(N, 3, 3) n to the inertial axes that n has at 0 s."""
    return Rotation.from_rotvec(np.outer(t, base.w_ie_n)).as_matrix()


def inertial_position(base: BaseMotion, t: Array) -> Array:
    """(3, N) IMU from the origin of n, in the inertial axes that n has at 0 s."""
    in_n = base.centre_position(t) + np.einsum("ijn,j->in", base.attitude(t).C_nb, base.r_b)
    return np.einsum("nij,jn->in", earth_turn(base, t), in_n)
