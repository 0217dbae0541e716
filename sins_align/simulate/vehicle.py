"""A simulated drive: the samples of an IMU and an odometer on a vehicle, and the truth."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from sins_align.simulate.odometer import draw_scale_error, measure_speed
from sins_align.simulate.random_streams import random_streams
from sins_align.simulate.sensors import (
    SensorErrors,
    draw_received,
    draw_sensor_errors,
    draw_stamp_jitter,
    measure,
)
from sins_align.simulate.truth import quaternion_of
from sins_align.simulate.vehicle_motion import vehicle_motion
from sins_align.simulate.vehicle_options import VehicleOptions
from sins_align.simulate.vehicle_track import Track, integrate_track
from sins_align.simulate.vehicle_truth import VehicleTruth
from sins_align.types import Array, ImuSamples, ImuSampling, IntArray, OdometerSamples


@dataclass(frozen=True, eq=False)
class VehicleRun:
    """Samples, truth, and the options they came from."""

    imu: ImuSamples
    odometer: OdometerSamples
    truth: VehicleTruth
    options: VehicleOptions

    def chunks(self, duration_s: float) -> Iterator[tuple[ImuSamples, OdometerSamples]]:
        """The samples in pieces of `duration_s` by stamp, for a publisher.

        A piece may be without samples of one kind, not of both.

        Raises
        ------
        ValueError : duration_s is not positive
        """
        if not duration_s > 0.0:
            raise ValueError(f"duration_s: {duration_s} is not positive")
        length = max(1, round(duration_s * 1e9))
        begin = int(self.imu.stamp_ns[0])
        imu_piece = (self.imu.stamp_ns - begin) // length
        odometer_piece = (self.odometer.stamp_ns - begin) // length
        for piece in np.union1d(imu_piece, odometer_piece):
            yield (
                self.imu.select(imu_piece == piece),
                self.odometer.select(odometer_piece == piece),
            )


def simulate_vehicle(options: VehicleOptions) -> VehicleRun:
    """Simulate a vehicle with an IMU and an odometer.

    Raises
    ------
    ValueError : the vehicle would come too near to a pole
    """
    streams = random_streams(options.seed)
    interval = 1.0 / options.rate_hz
    track = integrate_track(
        vehicle_motion(options, streams),
        np.array(options.odometer_lever_arm_m, dtype=float),
        (
            math.radians(options.latitude_deg),
            math.radians(options.longitude_deg),
            options.altitude_m,
        ),
        (-interval, options.duration_s + interval),
    )
    errors = draw_sensor_errors(options.imu_grade, streams)
    elapsed_ns = _elapsed_ns(options)
    w_ib_b, f_ib_b = _sense(track, elapsed_ns, options)
    w_ib_b, f_ib_b = measure(w_ib_b, f_ib_b, interval, options.imu_grade, errors, streams)
    stamp_ns = options.start_stamp_ns + elapsed_ns
    stamp_ns += draw_stamp_jitter(
        stamp_ns.size, options.stamp_jitter_s, interval, streams["jitter"]
    )
    imu = ImuSamples(stamp_ns, w_ib_b, f_ib_b)
    if options.lost_fraction > 0.0:
        imu = imu.select(draw_received(len(imu), options.lost_fraction, streams["losses"]))
    scale_error = draw_scale_error(options, streams)
    odometer = measure_speed(options, track.motion.route.speed, scale_error, streams)
    truth = _truth(options, track, errors, scale_error, int(stamp_ns[-1]))
    return VehicleRun(imu, odometer, truth, options)


def _elapsed_ns(options: VehicleOptions) -> IntArray:
    """(N,) times of the samples from the first one [ns]: whole nanoseconds, never drifting."""
    count = math.floor(options.duration_s * options.rate_hz + 1e-6) + 1
    return np.rint(np.arange(count) * (1e9 / options.rate_hz)).astype(np.int64)


def _sense(track: Track, elapsed_ns: IntArray, options: VehicleOptions) -> tuple[Array, Array]:
    end = elapsed_ns.astype(np.float64) * 1e-9
    if options.imu_sampling is ImuSampling.INSTANTANEOUS:
        return track.sense(end)
    begin = np.concatenate(([-1.0 / options.rate_hz], end[:-1]))
    return track.sense_mean(begin, end)


def _truth(
    options: VehicleOptions,
    track: Track,
    errors: SensorErrors,
    scale_error: float,
    stamp_ns: int,
) -> VehicleTruth:
    elapsed = np.array([(stamp_ns - options.start_stamp_ns) * 1e-9])
    return VehicleTruth(
        stamp_ns=stamp_ns,
        q_nb_wxyz=quaternion_of(track.motion.attitude(elapsed).C_nb[:, :, 0]),
        latitude_deg=options.latitude_deg,
        longitude_deg=options.longitude_deg,
        altitude_m=options.altitude_m,
        gyro_bias_rad_s=errors.gyro_bias,
        accel_bias_m_s2=errors.accel_bias,
        odometer_scale_error=scale_error,
        odometer_lever_arm_m=track.lever_arm_b,
        mounting_rpy_deg=np.array(options.mounting_rpy_deg, dtype=float),
        odometer_latency_s=options.odometer_latency_s,
        seed=options.seed,
        scenario=options.scenario,
        grade=options.grade if isinstance(options.grade, str) else "custom",
        rate_hz=options.rate_hz,
        sampling=options.imu_sampling.value,
        start_stamp_ns=options.start_stamp_ns,
        track=track,
    )
