"""Simulated drives through a session of `odo_align`: for the tests of the large-azimuth methods."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from sins_align.config import OdoConfig, odo_config
from sins_align.session import Session, Update
from sins_align.simulate import VehicleOptions, VehicleRun, simulate_vehicle
from sins_align.types import Array, Estimate


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
