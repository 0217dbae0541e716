"""Error models of gyros and accelerometers, and faults of the data stream."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from sins_align.grades import ImuGrade
from sins_align.types import Array, IntArray


@dataclass(frozen=True, eq=False)
class SensorErrors:
    """The errors of one IMU that stay as they are for a run.

    gyro_bias : (3,) [rad/s], accel_bias : (3,) [m/s^2]
    gyro_matrix, accel_matrix : (3, 3) from true to measured; scale errors on the diagonal
        of matrix - I, misalignments of the sensitive axes off it
    """

    gyro_bias: Array
    accel_bias: Array
    gyro_matrix: Array
    accel_matrix: Array


def draw_sensor_errors(grade: ImuGrade, streams: Mapping[str, Generator]) -> SensorErrors:
    """Draw the constant errors of one IMU; all normal, 1 sigma as in the grade."""
    return SensorErrors(
        grade.gyro_bias * streams["gyro_bias"].standard_normal(3),
        grade.accel_bias * streams["accel_bias"].standard_normal(3),
        _draw_matrix(grade.gyro_scale, grade.misalignment, streams["gyro_matrix"]),
        _draw_matrix(grade.accel_scale, grade.misalignment, streams["accel_matrix"]),
    )


def measure(
    w_ib_b: Array,
    f_ib_b: Array,
    interval: float,
    grade: ImuGrade,
    errors: SensorErrors,
    streams: Mapping[str, Generator],
) -> tuple[Array, Array]:
    """Samples of an imperfect IMU.

    w_measured = M_g w + b_g + drift + ARW / sqrt(interval) n,
    f_measured = M_a f + b_a + VRW / sqrt(interval) n, n white of unit variance: the spectral
    density does not depend on the rate. The drift is a first-order Gauss-Markov process.

    Parameters
    ----------
    w_ib_b, f_ib_b : (3, N) the truth [rad/s], [m/s^2]
    interval : from sample to sample [s]

    Returns
    -------
    (3, N) rate [rad/s] and (3, N) specific force [m/s^2]
    """
    size = w_ib_b.shape[1]
    w = errors.gyro_matrix @ w_ib_b + errors.gyro_bias[:, np.newaxis]
    f = errors.accel_matrix @ f_ib_b + errors.accel_bias[:, np.newaxis]
    w += grade.gyro_arw / math.sqrt(interval) * streams["gyro_noise"].standard_normal((3, size))
    f += grade.accel_vrw / math.sqrt(interval) * streams["accel_noise"].standard_normal((3, size))
    if grade.gyro_bias_instability > 0.0:
        step = interval / grade.gyro_bias_correlation_s
        w += grade.gyro_bias_instability * gauss_markov(step, size, streams["gyro_drift"])
    return w, f


def gauss_markov(step: float, size: int, stream: Generator) -> Array:
    """(3, size) first-order Gauss-Markov processes, stationary from the start, sigma 1.

    x_k = exp(-step) x_{k-1} + sqrt(1 - exp(-2 step)) n_k; step is in correlation times.
    """
    from scipy.signal import lfilter  # slow to import, and most grades do without

    drive = stream.standard_normal((3, size))
    drive[:, 1:] *= math.sqrt(-math.expm1(-2.0 * step))
    states: Array = lfilter([1.0], [1.0, -math.exp(-step)], drive, axis=1)
    return states


def draw_received(size: int, lost_fraction: float, stream: Generator) -> NDArray[np.bool_]:
    """(size,) True for the samples that arrive. The first and the last one always do."""
    received = stream.random(size) >= lost_fraction
    received[[0, -1]] = True
    return received


def draw_stamp_jitter(size: int, sigma_s: float, interval: float, stream: Generator) -> IntArray:
    """(size,) normal errors of the stamps [ns], cut at 0.45 interval: order is kept."""
    limit = 0.45 * interval
    jitter = np.clip(sigma_s * stream.standard_normal(size), -limit, limit)
    return np.rint(1e9 * jitter).astype(np.int64)


def _draw_matrix(scale: float, misalignment: float, stream: Generator) -> Array:
    sigma = np.full((3, 3), misalignment)
    np.fill_diagonal(sigma, scale)
    matrix: Array = np.eye(3) + sigma * stream.standard_normal((3, 3))
    return matrix
