"""The odometer of the simulated vehicle: what it counts, and what can go wrong."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from sins_align.simulate.vehicle_laws import SmoothLevels
from sins_align.simulate.vehicle_options import Spans, VehicleOptions
from sins_align.types import Array, OdometerSamples

_OUTLIERS = (-20.0, 40.0)  # [m/s]


def draw_scale_error(options: VehicleOptions, streams: Mapping[str, Generator]) -> float:
    """Measured over true distance, minus 1."""
    error = options.odometer_scale_sigma * streams["odometer_scale"].standard_normal()
    return float(error) if options.odometer_scale_error is None else options.odometer_scale_error


def measure_speed(
    options: VehicleOptions,
    speed: SmoothLevels,
    scale_error: float,
    streams: Mapping[str, Generator],
) -> OdometerSamples:
    """Samples of the odometer.

    With s the stamps of a perfect clock, dt apart, the value is the distance counted over
    (s - dt - latency, s - latency], divided by dt. Drift and jitter change stamps only.

    Parameters
    ----------
    speed : true speed over time [m/s]
    scale_error : measured over true distance, minus 1
    """
    interval = 1.0 / options.odometer_rate_hz
    first = (1.0 + streams["odometer_phase"].random()) * interval
    count = max(0, math.floor((options.duration_s - first) / interval + 1e-9) + 1)
    on_time: Array = first + interval * np.arange(count, dtype=np.float64)
    end = on_time - options.odometer_latency_s
    edges = np.concatenate((end[:1] - interval, end))
    value = np.diff(_count_distance(edges, options, speed, scale_error, streams)) / interval
    value += options.odometer_noise_m_s * streams["odometer_noise"].standard_normal(count)
    value[_within(on_time, options.stuck)] = 0.0
    chance, outlier = streams["odometer_outliers"].random((count, 2)).T
    wild = chance < options.outlier_fraction
    value[wild] = (_OUTLIERS[0] + (_OUTLIERS[1] - _OUTLIERS[0]) * outlier)[wild]

    jitter = options.odometer_jitter_s * streams["odometer_jitter"].standard_normal(count)
    jitter = np.clip(jitter, -0.45 * interval, 0.45 * interval)
    stamp_s = on_time + options.odometer_clock_drift * end + jitter
    stamp_ns = options.start_stamp_ns + np.rint(stamp_s * 1e9).astype(np.int64)
    variance = np.full(count, speed_variance(options) if options.odometer_report_variance else 0.0)
    samples = OdometerSamples(stamp_ns, value, variance)
    return samples.select(~_within(on_time, options.dropouts))


def speed_variance(options: VehicleOptions) -> float:
    """Variance of a sample's error: two roundings of the count, and the noise [m^2/s^2]."""
    rounding = options.odometer_quantum_m * options.odometer_rate_hz
    return rounding**2 / 6.0 + options.odometer_noise_m_s**2


def _count_distance(
    t: Array,
    options: VehicleOptions,
    speed: SmoothLevels,
    scale_error: float,
    streams: Mapping[str, Generator],
) -> Array:
    """(N,) distance that the wheel has counted at the times t (N,) [s], from 0 s on [m]."""
    law = speed.absolute() if options.unsigned_wheel else speed

    def driven(begin: float, end: Array) -> Array:
        return law(end)[0] - law(np.array([begin]))[0]

    distance = law(t)[0]
    if options.scale_step is not None:
        at_s, change = options.scale_step
        distance = distance + change * driven(at_s, np.maximum(t, at_s))
    slips = streams["odometer_slip"].uniform(0.0, options.duration_s, options.slip_count)
    for begin in slips:
        during = np.clip(t, begin, begin + options.slip_duration_s)
        distance = distance + options.slip_fraction * driven(float(begin), during)
    distance = (1.0 + scale_error) * distance
    phase = streams["odometer_phase"].random()
    quantum = options.odometer_quantum_m
    if quantum == 0.0:
        return distance
    counted: Array = quantum * np.floor(distance / quantum + phase)
    return counted


def _within(t: Array, spans: Spans) -> NDArray[np.bool_]:
    """(N,) whether t lies within one of the spans (begin, duration)."""
    inside = np.zeros(t.size, dtype=np.bool_)
    for begin, duration in spans:
        inside |= (t >= begin) & (t < begin + duration)
    return inside
