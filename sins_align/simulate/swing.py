"""A simulated swing: the samples of an IMU on a swinging base, and the truth."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from sins_align.simulate.attitude_motion import AxisRotation, Linear, RotationStep, SmoothTurn
from sins_align.simulate.base_motion import BaseMotion, CentreMotion, harmonic
from sins_align.simulate.drive import drive_motions
from sins_align.simulate.geodesy import earth_rate_n, plumb_gravity
from sins_align.simulate.options import SwingOptions
from sins_align.simulate.random_streams import random_streams
from sins_align.simulate.scenarios import paper_lever_arm
from sins_align.simulate.sensors import (
    SensorErrors,
    draw_received,
    draw_sensor_errors,
    draw_stamp_jitter,
    measure,
)
from sins_align.simulate.truth import SwingTruth, quaternion_of
from sins_align.types import Array, ImuSamples, ImuSampling, IntArray


@dataclass(frozen=True, eq=False)
class SwingRun:
    """Samples, truth, and the options they came from."""

    imu: ImuSamples
    truth: SwingTruth
    options: SwingOptions

    def chunks(self, duration_s: float) -> Iterator[ImuSamples]:
        """The samples in pieces of `duration_s` by stamp, for a publisher; none is empty.

        Raises
        ------
        ValueError : duration_s is not positive
        """
        if not duration_s > 0.0:
            raise ValueError(f"duration_s: {duration_s} is not positive")
        stamps = self.imu.stamp_ns
        piece = (stamps - stamps[0]) // max(1, round(duration_s * 1e9))
        edges = np.flatnonzero(np.diff(piece)) + 1
        for first, last in zip([0, *edges], [*edges, len(self.imu)], strict=True):
            yield self.imu.select(slice(int(first), int(last)))


def simulate_swing(options: SwingOptions) -> SwingRun:
    """Simulate an IMU on a swinging base."""
    streams = random_streams(options.seed)
    base = swing_base(options, streams)
    errors = draw_sensor_errors(options.imu_grade, streams)
    elapsed_ns = _elapsed_ns(options)
    w_ib_b, f_ib_b = _sense(base, elapsed_ns, options)
    w_ib_b, f_ib_b = measure(
        w_ib_b, f_ib_b, 1.0 / options.rate_hz, options.imu_grade, errors, streams
    )
    stamp_ns = options.start_stamp_ns + elapsed_ns
    stamp_ns += draw_stamp_jitter(
        stamp_ns.size, options.stamp_jitter_s, 1.0 / options.rate_hz, streams["jitter"]
    )
    imu = ImuSamples(stamp_ns, w_ib_b, f_ib_b)
    if options.lost_fraction > 0.0:
        imu = imu.select(draw_received(len(imu), options.lost_fraction, streams["losses"]))
    return SwingRun(imu, _truth(options, base, errors, int(stamp_ns[-1])), options)


def swing_base(options: SwingOptions, streams: Mapping[str, Generator]) -> BaseMotion:
    """The analytic motion that the options and the random phases describe."""
    phases = streams["attitude_phases"].uniform(0.0, math.tau, 3)
    heading, turn = math.radians(options.heading_deg), math.radians(options.turn_deg)
    # Headings are clockwise, rotations about up counter-clockwise.
    steps: list[RotationStep] = [AxisRotation(2, Linear(-heading))]
    if options.turn_deg != 0.0:
        law = SmoothTurn(-turn, options.turn_begin_s, options.turn_duration_s)
        steps.append(AxisRotation(2, law))
    scenario = options.motion
    lever_arm = options.lever_arm_m
    latitude = math.radians(options.latitude_deg)
    return BaseMotion(
        rotations=(*steps, *scenario.rotations(phases)),
        centre=(
            *_centre_motions(options, streams["centre_phases"]),
            *drive_motions(options, streams["swing_shake"]),
        ),
        r_b=paper_lever_arm(scenario) if lever_arm is None else np.array(lever_arm, dtype=float),
        w_ie_n=earth_rate_n(latitude),
        gravity=plumb_gravity(latitude, options.altitude_m),
    )


def _centre_motions(options: SwingOptions, stream: Generator) -> tuple[CentreMotion, ...]:
    heave_phase, sway_phase = stream.uniform(0.0, math.tau, 2)
    azimuth = math.radians(options.sway_azimuth_deg)
    horizontal = np.array([math.sin(azimuth), math.cos(azimuth), 0.0])
    up = np.array([0.0, 0.0, 1.0])
    heave = harmonic(options.heave_m, options.heave_period_s, heave_phase)
    sway = harmonic(options.sway_m, options.sway_period_s, sway_phase)
    motions = ((up, heave), (horizontal, sway))
    return tuple(CentreMotion(n, law) for n, law in motions if law.amplitude != 0.0)


def _elapsed_ns(options: SwingOptions) -> IntArray:
    """(N,) times of the samples from the first one [ns]: whole nanoseconds, never drifting."""
    count = math.floor(options.duration_s * options.rate_hz + 1e-6) + 1
    return np.rint(np.arange(count) * (1e9 / options.rate_hz)).astype(np.int64)


def _sense(base: BaseMotion, elapsed_ns: IntArray, options: SwingOptions) -> tuple[Array, Array]:
    end = elapsed_ns.astype(np.float64) * 1e-9
    if options.imu_sampling is ImuSampling.INSTANTANEOUS:
        return base.sense(end)
    begin = np.concatenate(([-1.0 / options.rate_hz], end[:-1]))
    return base.sense_mean(begin, end)


def _truth(
    options: SwingOptions, base: BaseMotion, errors: SensorErrors, stamp_ns: int
) -> SwingTruth:
    elapsed = np.array([(stamp_ns - options.start_stamp_ns) * 1e-9])
    scenario = options.motion
    return SwingTruth(
        stamp_ns=stamp_ns,
        q_nb_wxyz=quaternion_of(base.attitude(elapsed).C_nb[:, :, 0]),
        lever_arm_m=base.r_b,
        latitude_deg=options.latitude_deg,
        longitude_deg=options.longitude_deg,
        altitude_m=options.altitude_m,
        gyro_bias_rad_s=errors.gyro_bias,
        accel_bias_m_s2=errors.accel_bias,
        odometer_scale_error=None,
        seed=options.seed,
        scenario=scenario.name,
        grade=options.grade if isinstance(options.grade, str) else "custom",
        rate_hz=options.rate_hz,
        sampling=options.imu_sampling.value,
        paper_axes=scenario.paper_axes,
        C_paper_b=scenario.C_paper_b,
        drive_stamp_ns=_drive_stamp_ns(options),
        start_stamp_ns=options.start_stamp_ns,
        base=base,
    )


def _drive_stamp_ns(options: SwingOptions) -> tuple[int, int] | None:
    if options.drive_m == 0.0:
        return None
    begin = options.start_stamp_ns + round(1e9 * options.drive_begin_s)
    return begin, begin + round(1e9 * options.drive_duration_s)
