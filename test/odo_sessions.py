"""Simulated drives through a session of `odo_align`, and every bit of what comes out."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from sins_align.config import OdoConfig, odo_config
from sins_align.session import Session
from sins_align.simulate import VehicleOptions, VehicleRun, simulate_vehicle
from sins_align.types import Array, Estimate, Update


@cache
def vehicle(scenario: str, duration_s: float, **changes: Any) -> VehicleRun:
    options = {"rate_hz": 100.0, "seed": 3, **changes}
    run = simulate_vehicle(VehicleOptions(scenario=scenario, duration_s=duration_s, **options))
    for array in (*run.imu, *run.odometer):
        array.flags.writeable = False  # the tests share them
    return run


def config_of(run: VehicleRun, **parameters: Any) -> OdoConfig:
    """Settings that fit the drive."""
    options = run.options
    fitting = {
        "latitude_deg": options.latitude_deg,
        "longitude_deg": options.longitude_deg,
        "altitude_m": options.altitude_m,
        "imu_grade": options.grade,
        "imu_sampling": options.imu_sampling.value,
    }
    return odo_config({**fitting, **parameters})


def align(run: VehicleRun, **parameters: Any) -> tuple[Session, list[Update]]:
    session = Session(config_of(run, **parameters))
    updates = session.add_odometer(run.odometer)
    return session, updates + session.add_imu(run.imu)


def bits(estimate: Estimate | None) -> tuple[object, ...]:
    """Every bit of an estimate."""
    if estimate is None:
        return ()
    odometer = estimate.odometer
    arrays = [
        estimate.q_nb, estimate.misalignment_covariance, estimate.gyro_bias,
        estimate.gyro_bias_sigma, estimate.accel_bias, estimate.accel_bias_sigma,
    ]  # fmt: skip
    numbers: list[float] = [estimate.consistency]
    if odometer is not None:
        arrays += [
            odometer.mounting_rpy, odometer.mounting_covariance, odometer.lever_arm_b,
            odometer.lever_arm_covariance,
        ]  # fmt: skip
        numbers += [
            odometer.scale_error, odometer.scale_sigma, odometer.latency_s,
            odometer.latency_sigma_s,
        ]  # fmt: skip
    return estimate.stamp_ns, *(array.tobytes() for array in arrays), *map(repr, numbers)


def trace(updates: Sequence[Update]) -> list[tuple[object, ...]]:
    return [(u.stamp_ns, bits(u.estimate), u.status) for u in updates]


def hand_over(
    run: VehicleRun, imu_ns: int, lead_ns: int, session: Session
) -> Iterator[list[Update]]:
    """In pieces of imu_ns; the odometer is ahead of the IMU by lead_ns."""
    imu, odometer = run.imu, run.odometer
    begin, given = 0, 0
    last = int(imu.stamp_ns[-1])
    for until in range(int(imu.stamp_ns[0]), last + imu_ns, imu_ns):
        end = int(np.searchsorted(imu.stamp_ns, until, "right"))
        known = int(np.searchsorted(odometer.stamp_ns, until + lead_ns, "right"))
        if known > given:
            yield session.add_odometer(odometer.select(slice(given, known)))
        if end > begin:
            yield session.add_imu(imu.select(slice(begin, end)))
        begin, given = max(begin, end), max(given, known)
    yield session.add_odometer(odometer.select(slice(given, None)))


class Curve(NamedTuple):
    """What was given out, a row for every estimate.

    time_s : (n,) since the start; phi, sigma : (n, 3) misalignment and its 1 sigma [rad]
    scale : (n,) estimated scale error
    """

    time_s: Array
    phi: Array
    sigma: Array
    scale: Array

    @property
    def ratio(self) -> Array:
        """(n,) heading error over its sigma."""
        return np.abs(self.phi[:, 2] / self.sigma[:, 2])

    def at(self, time_s: float) -> int:
        """The row of the last estimate until then."""
        return int(np.searchsorted(self.time_s, time_s + 0.5)) - 1


def misalignment(run: VehicleRun, estimate: Estimate) -> Array:
    """(3,) phi: estimated = (I - [phi x]) true."""
    w, x, y, z = estimate.q_nb
    found = Rotation.from_quat([x, y, z, w])
    true = Rotation.from_matrix(run.truth.C_nb_at(estimate.stamp_ns))
    return -(found * true.inv()).as_rotvec()


def curve_of(run: VehicleRun, updates: Sequence[Update]) -> Curve:
    rows = []
    for update in updates:
        estimate = update.estimate
        if estimate is not None:
            time_s = (estimate.stamp_ns - run.options.start_stamp_ns) * 1e-9
            assert estimate.odometer is not None
            scale = estimate.odometer.scale_error
            rows.append((time_s, *misalignment(run, estimate), *estimate.sigma, scale))
    table = np.array(rows).reshape(len(rows), 8)
    return Curve(table[:, 0], table[:, 1:4], table[:, 4:7], table[:, 7])
