"""Drives of the simulator through the session of `odo_align`, second by second."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any
from unittest.mock import patch

import numpy as np

from evidence.monte_carlo import every_seed, misalignment
from evidence.odo_recording import Moment, RecordedSession, Start
from sins_align.config import OdoConfig, odo_config
from sins_align.config_path import shipped_config
from sins_align.odo import filter as odo_filter
from sins_align.odo import large_azimuth
from sins_align.parameters import read_parameter_file
from sins_align.rotation import rpy_from_dcm
from sins_align.session import Update
from sins_align.simulate import VehicleOptions, VehicleRun, simulate_vehicle
from sins_align.types import Array, State, Status

Parameters = Mapping[str, Any]
THRESHOLDS = ("heading_threshold_arcmin", "level_threshold_arcsec", "hold_s")


@dataclass(frozen=True)
class Drive:
    """One run, a row for every second; NaN where there is nothing yet.

    phi, sigma : (T, 3) misalignment and claimed 1 sigma, east, north, up [rad]
    tilt : (T, 2) error of roll and pitch (REP-103), estimate minus truth, as all that follow
    velocity : (T, 3) of the IMU, east, north, up [m/s]
    gyro_bias, accel_bias : (T, 3) in b, of their constant part [rad/s], [m/s^2]
    level_nees : (T,) normalised square of the levels
    scale_error, scale_sigma : (T,) measured over true distance minus 1
    published : (T,) whether there was an estimate for the user
    consistency : (T,)
    is_large : (T,) whether the filter is one of the large-azimuth model
    aligned : (T,) whether it was called so
    status : at the end; false_claims: updates that claimed more than their sigma says
    aligned_s : when it was aligned for the first time [s]; infinity: never
    """

    seed: int
    phi: Array
    sigma: Array
    tilt: Array
    velocity: Array
    gyro_bias: Array
    accel_bias: Array
    level_nees: Array
    scale_error: Array
    scale_sigma: Array
    published: Array
    consistency: Array
    is_large: Array
    aligned: Array
    status: Status
    false_claims: int
    aligned_s: float


def make_config(options: VehicleOptions, parameters: Parameters) -> OdoConfig:
    """Settings that fit the drive, with the thresholds of the shipped file."""
    place = {
        "latitude_deg": options.latitude_deg,
        "longitude_deg": options.longitude_deg,
        "altitude_m": options.altitude_m,
    }
    imu = {"imu_grade": options.grade, "imu_sampling": options.imu_sampling.value}
    shipped = read_parameter_file(shipped_config("odo_align.yaml"), "odo_align")
    return odo_config({**place, **imu, **{k: shipped[k] for k in THRESHOLDS}, **parameters})


def false_claims(updates: Sequence[Update], config: OdoConfig) -> int:
    """How many updates say aligned with a sigma above a threshold."""
    count = 0
    for update in updates:
        if update.status.state is not State.ALIGNED:
            continue
        assert update.estimate is not None
        east, north, heading = update.estimate.sigma
        level = config.completion.level_threshold
        count += not (
            heading < config.completion.heading_threshold and east < level and north < level
        )
    return count


def drive(options: VehicleOptions, parameters: Parameters, start: Start | None = None) -> Drive:
    """One simulated alignment."""
    return align(simulate_vehicle(options), parameters, start)


def drive_each(options: VehicleOptions, settings: Sequence[Parameters]) -> list[Drive]:
    """The same samples aligned with each of the settings."""
    simulated = simulate_vehicle(options)
    return [align(simulated, parameters) for parameters in settings]


def every_drive(
    options: VehicleOptions, settings: Mapping[str, Parameters], seeds: int
) -> dict[str, list[Drive]]:
    """The drives of all seeds for each of the settings, by their name."""
    runs = every_seed(drive_each, options, range(seeds), list(settings.values()))
    return {name: [run[k] for run in runs] for k, name in enumerate(settings)}


def align(simulated: VehicleRun, parameters: Parameters, start: Start | None = None) -> Drive:
    """The alignment of a simulated drive."""
    config = make_config(simulated.options, parameters)
    heading = float(simulated.truth.heading_at(int(simulated.imu.stamp_ns[0])))
    recorded = RecordedSession(config, start, heading)
    plain = start is not None and start.sigma_deg is not None
    limit = math.inf if plain else odo_filter.SOFT_LIMIT
    # The published fading by itself: the product goes back to wander_kf when it is lost.
    alone = plain or config.fading == "published"
    ratio = math.inf if alone else large_azimuth.LOST_RATIO
    with (
        patch.object(odo_filter, "SOFT_LIMIT", limit),
        patch.object(large_azimuth, "LOST_RATIO", ratio),
    ):
        updates = [] if config.stationary else recorded.add_odometer(simulated.odometer)
        updates += recorded.add_imu(simulated.imu)
    claims = [u.status for u in updates if u.status.state is State.ALIGNED]
    aligned_s = math.inf
    if claims:
        assert claims[0].aligned_at_s is not None
        aligned_s = claims[0].aligned_at_s
    return Drive(
        simulated.options.seed,
        *_tabulate(simulated, recorded.moments),
        _aligned(simulated.options, updates),
        recorded.status,
        false_claims(updates, config),
        aligned_s,
    )


def _aligned(options: VehicleOptions, updates: Sequence[Update]) -> Array:
    table = np.zeros(round(options.duration_s) + 1, dtype=bool)
    for update in updates:
        second = round((update.stamp_ns - options.start_stamp_ns) * 1e-9)
        table[second:] = update.status.state is State.ALIGNED
    return table


def _tabulate(simulated: VehicleRun, moments: Sequence[Moment]) -> list[Array]:
    """The fields of `Drive` that are tables."""
    options, true = simulated.options, simulated.truth
    if moments:
        stamps = np.array([m.stamp_ns for m in moments])
        time_s = (stamps - options.start_stamp_ns) * 1e-9
        C_nb, v_n = true.C_nb_at(stamps), true.v_n_at(stamps)
        scale = np.full(stamps.size, 1.0 + true.odometer_scale_error)
        if options.scale_step is not None:
            at_s, change = options.scale_step
            scale[time_s > at_s] *= 1.0 + change
    fields = (3, 3, 2, 3, 3, 3, 1, 1, 1, 1, 1, 1)
    table = np.full((round(options.duration_s) + 1, sum(fields)), np.nan)
    for k, m in enumerate(moments):
        phi = misalignment(m.C_nb, C_nb[:, :, k])
        tilt = np.subtract(rpy_from_dcm(m.C_nb)[:2], rpy_from_dcm(C_nb[:, :, k])[:2])
        table[round(time_s[k]) :] = (
            *phi, *np.sqrt(m.covariance.diagonal()), *tilt, *(m.velocity - v_n[:, k]),
            *(m.gyro_bias - true.gyro_bias_rad_s), *(m.accel_bias - true.accel_bias_m_s2),
            phi[:2] @ np.linalg.solve(m.covariance[:2, :2], phi[:2]),
            m.scale[0] + 1.0 - scale[k], m.scale[1], m.published, m.consistency, m.is_large,
        )  # fmt: skip
    parts = np.split(table, np.cumsum(fields)[:-1], axis=1)
    return [part[:, 0] if part.shape[1] == 1 else part for part in parts]
