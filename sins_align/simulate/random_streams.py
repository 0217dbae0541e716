"""Independent random streams from one seed, one for each purpose.

A purpose that is not used, or used more, changes no other one's numbers.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

# Append only: the position of a name decides its numbers.
_PURPOSES = (
    "attitude_phases",
    "centre_phases",
    "gyro_bias",
    "accel_bias",
    "gyro_matrix",
    "accel_matrix",
    "gyro_noise",
    "accel_noise",
    "gyro_drift",
    "losses",
    "jitter",
    "vehicle_heading",
    "vehicle_ground",
    "vehicle_route",
    "vehicle_road",
    "vehicle_direction",
    "vehicle_standing",
    "odometer_phase",
    "odometer_scale",
    "odometer_noise",
    "odometer_slip",
    "odometer_outliers",
    "odometer_jitter",
    "vehicle_course",
    "swing_shake",
)


def random_streams(seed: int) -> Mapping[str, np.random.Generator]:
    """A generator for each purpose."""
    children = np.random.SeedSequence(seed).spawn(len(_PURPOSES))
    return {
        name: np.random.default_rng(child) for name, child in zip(_PURPOSES, children, strict=True)
    }
