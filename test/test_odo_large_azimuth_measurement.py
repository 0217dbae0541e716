"""The map of the large-azimuth filters' measurement, H(U) x + h(U), on a simulated drive.

What is computed stays as it is, the truth is turned by a finite azimuth error U and changed by
small errors of everything else; the odometer is exact.
"""

from __future__ import annotations

import math
from functools import cache
from typing import NamedTuple

import numpy as np
import pytest
from large_azimuth_maps import MILLIMETRE, at_angle, every_angle, keep, turn
from scipy.spatial.transform import Rotation
from test_odo_error_model import SEMI_MAJOR
from test_odo_wander import (
    ALPHA,
    EXACT,
    RATE_HZ,
    Faults,
    config,
    drive,
    epoch_at,
    second_of_most,
    small_turn,
    true_navigation,
)

from sins_align.odo.large_azimuth_model import PATH
from sins_align.odo.layout import (
    ACCEL_BIAS,
    ENU_SIZE,
    GYRO_BIAS,
    GYRO_TURN,
    ODOMETER,
    PHI,
    PLACE,
    VELOCITY,
    U,
)
from sins_align.odo.navigation import WanderNavigation
from sins_align.odo.odometer_model import (
    DIRECTION,
    GRADIENT,
    LATENCY,
    LEVER,
    MOUNTING,
    POSITION,
    SCALE,
    OdometerModel,
)
from sins_align.types import Array


class Start(NamedTuple):
    """Errors at the start of the epoch: U, and one state more by `size`."""

    angle: float
    index: int = 0
    size: float = 0.0


# Of the size of a prior's sigma, so small that its square does not matter.
STATES = {
    **{f"phi {k}": (PHI.start + k, 1e-3) for k in range(3)},
    **{f"velocity {k}": (VELOCITY.start + k, 0.1) for k in range(3)},
    **{f"gyro bias {k}": (GYRO_BIAS.start + k, 1e-4) for k in range(3)},
    **{f"accel bias {k}": (ACCEL_BIAS.start + k, 1e-2) for k in range(3)},
    **{f"gyro turn {k}": (GYRO_TURN.start + k, 1e-3) for k in range(3)},
    "scale": (ODOMETER.start + SCALE, 3e-3),
    "latency": (ODOMETER.start + LATENCY, 0.02),
    **{f"lever {k}": (ODOMETER.start + LEVER.start + k, 0.2) for k in range(3)},
    **{f"mounting {k}": (ODOMETER.start + MOUNTING.start + k, 3e-3) for k in range(2)},
    **{f"direction {k}": (ODOMETER.start + DIRECTION.start + k, 3e-3) for k in range(2)},
    **{f"gradient {k}": (ODOMETER.start + GRADIENT.start + k, 3e-3) for k in range(2)},
    **{f"position {k}": (ODOMETER.start + POSITION.start + k, 0.02) for k in range(3)},
}


def second_for(index: int) -> float:
    return second_of_most(
        index not in (ODOMETER.start + LATENCY, ODOMETER.start + GRADIENT.start + 1)
    )


class Seen(NamedTuple):
    """z as measured, as expected of the errors at the start, and of those at the end."""

    z: Array
    from_start: Array
    from_end: Array


def see(start: Start) -> Seen:
    """An epoch with these errors at its start."""
    second = second_for(start.index)
    truth, later = truth_at(second), truth_at(second + 1.0)
    x = np.zeros(ENU_SIZE)
    x[start.index] = start.size
    x[U] += start.angle
    turned = turn(x[U])
    navigation = true_navigation(second, ALPHA)
    navigation.C_ab = small_turn([x[0], x[1], 0.0]) @ turned @ truth.C_ab
    navigation.v_a = turned @ truth.v_a + x[VELOCITY]
    x[VELOCITY] = navigation.v_a - truth.v_a
    north = np.array([math.sin(ALPHA), math.cos(ALPHA), 0.0])
    latitude = truth.latitude + float(north @ x[PLACE]) / SEMI_MAJOR
    navigation.e_a = math.cos(latitude) * north + [0.0, 0.0, math.sin(latitude)]
    navigation.altitude += x[PLACE][2]
    odometer = OdometerModel(config(**EXACT))
    faults = Faults()
    if start.index < ODOMETER.start:
        gyro = x[GYRO_BIAS] + x[GYRO_TURN] * turning_rate(second)
        faults = Faults(gyro=gyro, accel=x[ACCEL_BIAS])
    elif start.index == ODOMETER.start + SCALE:
        faults = Faults(scale=-start.size)
    elif start.index == ODOMETER.start + LATENCY:
        # A clock that is ahead is read too late.
        faults = Faults(latency=start.size)
    elif start.index < ODOMETER.stop:
        odometer.x = odometer.x + x[ODOMETER]
    epoch = epoch_at(second, faults)
    keeper = keep(navigation, odometer, epoch)
    F, g = at_angle(keeper.maps[0], x[U])
    y = F @ x + g
    H, h = at_angle(keeper.maps[1], y[U])
    # The errors at the end, as far as the navigation shows them.
    C_ab, v_a = keeper.ends[1]
    off = C_ab @ later.C_ab.T
    seen = y.copy()
    seen[0], seen[1] = off[1, 2], -off[0, 2]
    seen[U] = math.atan2(off[0, 1] - off[1, 0], off[0, 0] + off[1, 1])
    seen[VELOCITY] = v_a - later.v_a
    seen[PATH] = keeper.path - true_path(second)
    H_end, h_end = at_angle(keeper.maps[1], seen[U])
    return Seen(keeper.residual, H @ y + h, H_end @ seen + h_end)


@cache
def turning_rate(second: float) -> float:
    """About the vertical, mean [rad/s]."""
    turned = Rotation.from_matrix(epoch_at(second).C_end).as_rotvec()
    return float(truth_at(second).C_ab[2] @ turned)


@cache
def truth_at(second: float) -> WanderNavigation:
    return true_navigation(second, ALPHA)


@cache
def true_path(second: float) -> Array:
    """int v dt of the truth, in a, over an epoch: by Simpson's rule."""
    stamps = drive().imu.stamp_ns[round(second * RATE_HZ) :][: RATE_HZ + 1]
    v_n = np.array([drive().truth.v_n_at(int(stamp)) for stamp in stamps])
    weight = np.ones(RATE_HZ + 1)
    weight[1:-1:2], weight[2:-1:2] = 4.0, 2.0
    return turn(ALPHA) @ (weight @ v_n) / (3.0 * RATE_HZ)


# Of all errors together; the smallest of their effects is 0.2 mm.
Z_TOLERANCE = 0.03 * MILLIMETRE


# What the navigation shows of the errors at the end, z follows from.
Z_END_TOLERANCE = 0.03 * MILLIMETRE


@every_angle
@pytest.mark.parametrize("name", STATES)
def test_displacement(name: str, angle: float) -> None:
    """Residual by an error of one state, beside a finite U: difference of two signs."""
    index, size = STATES[name]
    plus, minus = (see(Start(angle, index, sign * size)) for sign in (1.0, -1.0))
    z, from_start, from_end = (0.5 * (a - b) for a, b in zip(plus, minus, strict=True))
    np.testing.assert_allclose(from_start, z, rtol=0.0, atol=Z_TOLERANCE)
    if "position" not in name:  # which is in the path, and not in the navigation's
        np.testing.assert_allclose(from_end, z, rtol=0.0, atol=Z_END_TOLERANCE)
    if name != "phi 2":
        assert np.linalg.norm(z) > 6.0 * Z_TOLERANCE
    else:
        # The velocity has turned with the attitude: nothing is seen of U, though z(U) is large.
        assert np.linalg.norm(z) < Z_TOLERANCE


@every_angle
def test_displacement_with_an_azimuth_error_alone(angle: float) -> None:
    z, from_start, from_end = see(Start(angle))
    np.testing.assert_allclose(from_start, z, rtol=0.0, atol=Z_TOLERANCE)
    np.testing.assert_allclose(from_end, z, rtol=0.0, atol=Z_END_TOLERANCE)


@every_angle
@pytest.mark.parametrize("axis", [0, 1])
def test_displacement_of_a_place_that_is_wrong(axis: int, angle: float) -> None:
    """Ten kilometres turn the axis, and with it the frame under the displacement by 0.5 um."""
    plus, minus = (see(Start(angle, PLACE.start + axis, sign * 1e4)) for sign in (1.0, -1.0))
    z, from_start, from_end = (0.5 * (a - b) for a, b in zip(plus, minus, strict=True))
    np.testing.assert_allclose(from_end, z, rtol=0.0, atol=5e-5 * MILLIMETRE)
    # Gravity at another latitude is left out.
    np.testing.assert_allclose(from_start[:2], z[:2], rtol=0.0, atol=2e-3 * MILLIMETRE)
