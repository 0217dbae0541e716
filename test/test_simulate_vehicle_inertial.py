"""A perfect IMU, integrated in inertial space, must arrive where the truth says.

Nothing here is in ENU: attitude and position are against inertial axes, gravity is that of
`sins_align.earth` along the ellipsoid's normal. Only the comparison goes back to ENU.
"""

import dataclasses

import numpy as np
import pytest
from scipy.integrate import cumulative_simpson
from scipy.spatial.transform import Rotation

from sins_align import earth
from sins_align.simulate import (
    VEHICLE_SCENARIOS,
    VehicleOptions,
    VehicleRun,
    simulate_vehicle,
)
from sins_align.types import Array, ImuSamples

A, E2, RATE = earth.SEMI_MAJOR_AXIS, earth.ECCENTRICITY_SQUARED, earth.EARTH_RATE

PERFECT = VehicleOptions(
    scenario="ring",
    grade="perfect",
    seed=4,
    duration_s=100.0,
    rate_hz=200.0,
    sampling="instantaneous",
    odometer_lever_arm_m=(0.3, 1.2, -0.5),
    mounting_rpy_deg=(1.0, -2.0, 40.0),
)


def enu_axes(latitude: Array, longitude: Array) -> Array:
    """(N, 3, 3) C_en, ENU to Earth-fixed axes."""
    sL, cL, so, co = np.sin(latitude), np.cos(latitude), np.sin(longitude), np.cos(longitude)
    zero = np.zeros_like(sL)
    rows = [[-so, -sL * co, cL * co], [co, -sL * so, cL * so], [zero, cL, sL]]
    return np.moveaxis(np.array(rows), -1, 0)


def earth_position(place: Array) -> Array:
    """(3, N) Earth-fixed position of latitude, longitude, altitude (3, N)."""
    latitude, longitude, h = place
    n = A / np.sqrt(1.0 - E2 * np.sin(latitude) ** 2)
    horizontal = (n + h) * np.cos(latitude)
    return np.stack(
        (
            horizontal * np.cos(longitude),
            horizontal * np.sin(longitude),
            (n * (1.0 - E2) + h) * np.sin(latitude),
        )
    )


def geodetic(r_e: Array) -> Array:
    """(3, N) latitude, longitude, altitude of Earth-fixed positions (3, N)."""
    horizontal = np.hypot(r_e[0], r_e[1])
    latitude = np.arctan2(r_e[2], horizontal * (1.0 - E2))
    for _ in range(6):
        n = A / np.sqrt(1.0 - E2 * np.sin(latitude) ** 2)
        latitude = np.arctan2(r_e[2] + E2 * n * np.sin(latitude), horizontal)
    h = horizontal * np.cos(latitude) + r_e[2] * np.sin(latitude)
    h -= A * np.sqrt(1.0 - E2 * np.sin(latitude) ** 2)
    return np.stack((latitude, np.arctan2(r_e[1], r_e[0]), h))


def earth_turn(t: Array) -> Rotation:
    """Earth-fixed to inertial axes; the same at 0 s."""
    return Rotation.from_rotvec(np.outer(RATE * t, [0.0, 0.0, 1.0]))


def gravitation(r_e: Array) -> Array:
    """(3, N) in Earth-fixed axes [m/s^2]: gravity without the centrifugal acceleration."""
    latitude, longitude, h = geodetic(r_e)
    some = np.unique(np.linspace(0, latitude.size - 1, 400).astype(int))
    values = [earth.normal_gravity(float(latitude[k]), float(h[k])) for k in some]
    g = np.interp(np.arange(latitude.size), some, values)
    pull = -g * enu_axes(latitude, longitude)[:, :, 2].T
    pull[:2] -= RATE**2 * r_e[:2]
    return pull


def body_turns(w: Array, step: float) -> Rotation:
    """Turn since the start, at every second sample; rates (3, 2n+1), `step` between them.

    Magnus expansion to fourth order: the error is that of Simpson's rule, and of coning
    beyond the quadratic.
    """
    first, middle, last = w[:, :-2:2].T, w[:, 1:-1:2].T, w[:, 2::2].T
    vector = step / 3.0 * (first + 4.0 * middle + last) + step**2 / 3.0 * np.cross(first, last)
    turns = np.empty((vector.shape[0] + 1, 4))
    turns[0] = (0.0, 0.0, 0.0, 1.0)
    turns[1:] = Rotation.from_rotvec(vector).as_quat()
    reach = 1  # products of 1, 2, 4, ... turns
    while reach < len(turns):
        turns[reach:] = (
            Rotation.from_quat(turns[:-reach]) * Rotation.from_quat(turns[reach:])
        ).as_quat()
        reach *= 2
    return Rotation.from_quat(turns)


def integrate(run: VehicleRun) -> tuple[Array, Array, Array, Array]:
    """Stamps (N,), C_nb (N, 3, 3), v_n (3, N) and place (3, N) from the IMU alone."""
    imu, truth = run.imu, run.truth
    stamp_ns = imu.stamp_ns[::2]
    t = (stamp_ns - stamp_ns[0]) * 1e-9
    start = int(stamp_ns[0])
    place = truth.position_at(start)
    C_en = enu_axes(place[:1], place[1:2])[0]
    r_0 = earth_position(place[:, np.newaxis])[:, 0]
    v_0 = C_en @ truth.v_n_at(start) + np.cross([0.0, 0.0, RATE], r_0)
    C_ib = Rotation.from_matrix(C_en @ truth.C_nb_at(start)) * body_turns(
        imu.w_ib_b, 1.0 / run.options.rate_hz
    )
    f_i = C_ib.apply(imu.f_ib_b[:, ::2].T).T
    to_inertial = earth_turn(t)
    r_i = to_inertial.apply(r_0).T
    for _ in range(30):  # Picard: gravitation along the last round's path
        pull = to_inertial.apply(gravitation(to_inertial.inv().apply(r_i.T).T).T).T
        v_i = v_0[:, np.newaxis] + cumulative_simpson(f_i + pull, x=t, initial=0.0)
        last, r_i = r_i, r_0[:, np.newaxis] + cumulative_simpson(v_i, x=t, initial=0.0)
        if np.abs(r_i - last).max() < 1e-6:
            break
    r_e = to_inertial.inv().apply(r_i.T).T
    v_e = to_inertial.inv().apply(v_i.T).T - np.cross([0.0, 0.0, RATE], r_e.T).T
    place = geodetic(r_e)
    C_ne = np.swapaxes(enu_axes(place[0], place[1]), 1, 2)
    C_nb = C_ne @ (to_inertial.inv() * C_ib).as_matrix()
    return stamp_ns, C_nb, np.einsum("nij,jn->in", C_ne, v_e), place


def errors(run: VehicleRun) -> tuple[float, float, float]:
    """Largest errors of attitude [rad], velocity [m/s] and position [m]."""
    stamp_ns, C_nb, v_n, place = integrate(run)
    true = np.moveaxis(run.truth.C_nb_at(stamp_ns), -1, 0)
    attitude = np.abs(np.einsum("nij,nkj->nik", C_nb, true) - np.eye(3)).max()
    velocity = np.abs(v_n - run.truth.v_n_at(stamp_ns)).max()
    way = earth_position(place) - earth_position(run.truth.position_at(stamp_ns))
    return float(attitude), float(velocity), float(np.abs(way).max())


# What remains is the test's own: rates between samples 5 ms apart are taken as quadratic,
# and a micrometre is the rounding of an inertial position of 6.4e6 m over the run.
ATTITUDE_TOLERANCE = 5e-9  # [rad]
VELOCITY_TOLERANCE = 1e-5  # [m/s]
POSITION_TOLERANCE = 1e-3  # [m]


def assert_arrives(run: VehicleRun) -> None:
    attitude, velocity, position = errors(run)
    assert attitude < ATTITUDE_TOLERANCE
    assert velocity < VELOCITY_TOLERANCE
    assert position < POSITION_TOLERANCE


def test_ring_for_ten_minutes() -> None:
    assert_arrives(simulate_vehicle(dataclasses.replace(PERFECT, duration_s=600.0)))


@pytest.mark.parametrize("scenario", VEHICLE_SCENARIOS)
def test_every_drive(scenario: str) -> None:
    assert_arrives(simulate_vehicle(dataclasses.replace(PERFECT, scenario=scenario)))


def test_in_reverse() -> None:
    options = dataclasses.replace(PERFECT, scenario="reverse", duration_s=200.0, rate_hz=100.0)
    run = simulate_vehicle(options)
    assert run.truth.speed_at(run.imu.stamp_ns).min() < -2.5
    # 100 Hz: what is left out of the rates grows by 2^4.
    assert errors(run)[0] < 16.0 * ATTITUDE_TOLERANCE


@pytest.mark.parametrize("latitude_deg", [-60.0, 0.0, 75.0, 85.0, 89.9])
def test_everywhere(latitude_deg: float) -> None:
    assert_arrives(
        simulate_vehicle(
            dataclasses.replace(
                PERFECT, scenario="straight", latitude_deg=latitude_deg, longitude_deg=-30.0,
                altitude_m=1500.0,
            )
        )
    )  # fmt: skip


def test_a_missing_lever_arm_would_be_noticed() -> None:
    """The tolerances are far below what a wrong lever arm does."""
    run = simulate_vehicle(PERFECT)
    other = simulate_vehicle(dataclasses.replace(PERFECT, odometer_lever_arm_m=(0.3, 1.2, 0.0)))
    assert errors(dataclasses.replace(run, imu=other.imu))[1] > 1e3 * VELOCITY_TOLERANCE


def test_a_wrong_rate_would_be_noticed() -> None:
    """A tenth of the transport rate at 10 m/s, for 100 s."""
    run = simulate_vehicle(PERFECT)
    imu = ImuSamples(run.imu.stamp_ns, run.imu.w_ib_b - 1e-7, run.imu.f_ib_b)
    assert errors(dataclasses.replace(run, imu=imu))[0] > 1e3 * ATTITUDE_TOLERANCE
