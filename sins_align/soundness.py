"""What is refused at the door: positions, arrays, blocks, estimates that nothing can be made of."""

from __future__ import annotations

import math

import numpy as np

from sins_align.reasons import FORCE_IN_G, FORCE_SIZE, GRAVITY_REMOVED, SLOW_IMU, Finding
from sins_align.types import Estimate, ImuBlock, ImuSamples, OdometerSamples, Position

# 10 Hz with room for jitter; slower, nothing is left of a swing between two samples.
MAX_INTERVAL_S = 0.125
# Root mean square over a block [m/s^2]; a swing adds little to gravity.
LEAST_FORCE, GREATEST_FORCE = 7.0, 14.0
# Of gravity in g, and of what is left where gravity has been taken off.
LEAST_FORCE_IN_G, GREATEST_FORCE_IN_G = 0.7, 1.4


def find_fault(block: ImuBlock) -> Finding | None:
    """Why nothing can be made of a block; None where something can."""
    stamps = block.stamp_ns
    interval = int(stamps[-1] - stamps[0]) * 1e-9 / (stamps.shape[0] - 1)
    if interval > MAX_INTERVAL_S:  # so it may be where samples are lost, but not all steps
        interval = float(np.quantile(np.diff(stamps), 0.25)) * 1e-9
    if interval > MAX_INTERVAL_S:
        return SLOW_IMU(rate_hz=1.0 / interval)
    f = block.f_ib_b
    force = math.sqrt(float(np.einsum("ik,ik->", f, f)) / f.shape[1])
    if LEAST_FORCE < force < GREATEST_FORCE:
        return None
    if LEAST_FORCE_IN_G < force < GREATEST_FORCE_IN_G:
        return FORCE_IN_G(force=force)
    return (GRAVITY_REMOVED if force < LEAST_FORCE else FORCE_SIZE)(force=force)


def is_sound(estimate: Estimate) -> bool:
    """Whether an estimate is fit to be shown: finite, and no variance below zero."""
    P = estimate.misalignment_covariance
    finite = np.isfinite(P).all() and np.isfinite(estimate.q_nb).all()
    return bool(finite and (P.diagonal() >= 0.0).all())


def check_position(position: Position) -> None:
    """Refuse what is not a position on the Earth.

    Raises
    ------
    ValueError : says which
    """
    values = (position.latitude, position.longitude, position.altitude)
    if not all(map(math.isfinite, values)) or abs(position.latitude) > 0.5 * math.pi:
        raise ValueError(f"{position} is not a position on the Earth")


def check_odometer_arrays(samples: OdometerSamples) -> None:
    """As `check_arrays`.

    Raises
    ------
    ValueError : names the array
    """
    size = np.size(samples.stamp_ns)
    _check_array("stamp_ns", samples.stamp_ns, np.int64, (size,))
    _check_array("speed", samples.speed, np.float64, (size,))
    _check_array("variance", samples.variance, np.float64, (size,))


def check_arrays(samples: ImuSamples) -> None:
    """Refuse what would go wrong later, and far from its cause.

    Raises
    ------
    ValueError : names the array
    """
    size = np.size(samples.stamp_ns)
    _check_array("stamp_ns", samples.stamp_ns, np.int64, (size,))
    _check_array("w_ib_b", samples.w_ib_b, np.float64, (3, size))
    _check_array("f_ib_b", samples.f_ib_b, np.float64, (3, size))


def _check_array(name: str, array: object, dtype: type, shape: tuple[int, ...]) -> None:
    if not isinstance(array, np.ndarray) or array.dtype.type is not dtype:
        kind = array.dtype if isinstance(array, np.ndarray) else type(array).__name__
        raise ValueError(f"{name}: an array of {dtype.__name__} is expected, not {kind}")
    if array.shape != shape:
        wanted = "(N,)" if name == "stamp_ns" else shape
        raise ValueError(f"{name}: shape {wanted} is expected, not {array.shape}")
