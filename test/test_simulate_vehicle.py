"""The vehicle's motion: derivatives, what its suspension does, truth, seeds, settings."""

import dataclasses
import itertools
import json
import math

import numpy as np
import pytest
from scipy.integrate import cumulative_simpson
from scipy.spatial.transform import Rotation

from sins_align.earth import radii_of_curvature
from sins_align.simulate import (
    VEHICLE_SCENARIOS,
    VehicleOptions,
    VehicleRun,
    simulate_vehicle,
)
from sins_align.simulate.geodesy import earth_rate_n
from sins_align.simulate.vehicle_laws import LevelPlan
from sins_align.types import Array

DEG = math.pi / 180.0
ARCSEC = DEG / 3600.0
SHORT = VehicleOptions(
    scenario="urban",
    grade="perfect",
    seed=7,
    duration_s=120.0,
    rate_hz=10.0,
    odometer_lever_arm_m=(0.3, 1.2, -0.5),
    mounting_rpy_deg=(2.0, -3.0, 50.0),
)
QUIET = {
    "road_motion_deg": 0.0,
    "direction_noise_deg": 0.0,
    "standing_motion_arcsec": 0.0,
    "sideslip_deg_per_m_s2": 0.0,
    "suspension_roll_deg_per_m_s2": 0.0,
    "suspension_pitch_deg_per_m_s2": 0.0,
}

STEP = 0.005
FIRST = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0, 4 / 5, -1 / 5, 4 / 105, -1 / 280])


def run(**changes: object) -> VehicleRun:
    return simulate_vehicle(dataclasses.replace(SHORT, **changes))


def stencil(t: Array) -> Array:
    """(9 N,) the times of a central difference around each of t (N,)."""
    return (t + STEP * np.arange(-4, 5)[:, np.newaxis]).ravel()


def differentiate(values: Array) -> Array:
    """(..., N) derivative of the values (..., 9 N) at the stencil."""
    shaped = values.reshape(*values.shape[:-1], 9, -1)
    return np.einsum("k,...kn->...n", FIRST, shaped) / STEP


def travel_in_vehicle(drive: VehicleRun, stamps: Array) -> Array:
    """(3, N) direction of the IMU's travel in vehicle axes."""
    C_bm = Rotation.from_euler("xyz", drive.truth.mounting_rpy_deg, degrees=True).as_matrix()
    v_b = np.einsum("jin,jn->in", drive.truth.C_nb_at(stamps), drive.truth.v_n_at(stamps))
    v_m = C_bm.T @ v_b
    return v_m / np.linalg.norm(v_m, axis=0)


# --- laws ---------------------------------------------------------------------------------


def test_levels_are_kept_and_integrated() -> None:
    plan = LevelPlan(2.0)
    plan.hold(10.0)
    plan.change(-4.0, 5.0)
    plan.hold(3.0)
    plan.change(0.0, 2.0)
    law = plan.law()
    x = np.array([-3.0, 0.0, 10.0, 12.5, 15.0, 18.0, 20.0, 1000.0])
    rows = law(x)
    np.testing.assert_allclose(rows[1], [2, 2, 2, -1, -4, -4, 0, 0], atol=1e-14)
    np.testing.assert_allclose(rows[0, [0, 1, 2, 4, 5, 6, 7]], [-6, 0, 20, 15, 3, -1, -1])
    assert rows[0, 6] == pytest.approx(plan.integral)
    fine = np.linspace(-2.0, 22.0, 24001)
    rows = law(fine)
    for low, high in itertools.pairwise(rows):
        # The last derivative has kinks: gradient is wrong there by its slope times a step.
        np.testing.assert_allclose(np.gradient(low, fine)[2:-2], high[2:-2], atol=1e-3)


def test_magnitude_of_levels() -> None:
    plan = LevelPlan(3.0)
    plan.hold(5.0)
    plan.change(0.0, 4.0)
    plan.change(-2.0, 4.0)
    law = plan.law()
    t = np.linspace(-3.0, 30.0, 500)
    np.testing.assert_allclose(law.absolute()(t)[1], np.abs(law(t)[1]), atol=1e-14)
    np.testing.assert_allclose(law.absolute()(np.array([20.0]))[0], [15 + 6 + 4 + 14])


# --- motion -------------------------------------------------------------------------------


@pytest.mark.parametrize("scenario", VEHICLE_SCENARIOS)
def test_derivatives(scenario: str) -> None:
    """Central differences of 8th order; the laws have four derivatives, hence not 1e-12."""
    track = run(scenario=scenario).truth.track
    t = np.linspace(1.0, 119.0, 300)
    attitude = track.motion.attitude(stencil(t))
    middle = slice(4 * t.size, 5 * t.size)
    C, w, dw = attitude.C_nb[..., middle], attitude.w_nb_b[:, middle], attitude.dw_nb_b[:, middle]
    turn = np.einsum("ijn,ikn->jkn", C, differentiate(attitude.C_nb))
    np.testing.assert_allclose([turn[2, 1], turn[0, 2], turn[1, 0]], w, atol=1e-10)
    np.testing.assert_allclose(differentiate(attitude.w_nb_b), dw, atol=1e-8)
    motion = track.imu_motion(stencil(t))
    np.testing.assert_allclose(differentiate(motion.v_n), motion.a_n[:, middle], atol=1e-8)


@pytest.mark.parametrize("scenario", VEHICLE_SCENARIOS)
def test_position_is_the_integral_of_velocity(scenario: str) -> None:
    track = run(scenario=scenario, latitude_deg=60.0).truth.track
    t = np.linspace(20.0, 80.0, 12001)
    v_n, place = track.imu_motion(t).v_n, track.place(t)
    radii = np.array([radii_of_curvature(float(L)) for L in place.latitude]).T + place.altitude
    rates = [v_n[1] / radii[0], v_n[0] / radii[1] / np.cos(place.latitude), v_n[2]]
    way = cumulative_simpson(rates, x=t, initial=0.0)
    way -= np.stack(place) - np.stack(place)[:, :1]
    # Between the points of the grid interpolation is good to a few micrometres.
    np.testing.assert_allclose(way * [[6.4e6], [3.2e6], [1.0]], 0.0, atol=1e-5)


@pytest.mark.parametrize("scenario", VEHICLE_SCENARIOS)
def test_velocity_at_the_odometer(scenario: str) -> None:
    """v_O = v_imu + w_eb x l is along the vehicle, speed and all, but for sideslip."""
    drive = run(scenario=scenario, **QUIET)
    stamps = drive.imu.stamp_ns
    t = (stamps - stamps[0]) * 1e-9
    w = drive.truth.track.motion.attitude(t).w_nb_b
    l_b = np.array(SHORT.odometer_lever_arm_m)
    v_b = np.einsum("jin,jn->in", drive.truth.C_nb_at(stamps), drive.truth.v_n_at(stamps))
    C_bm = Rotation.from_euler("xyz", SHORT.mounting_rpy_deg, degrees=True).as_matrix()
    v_m = C_bm.T @ (v_b + np.cross(w.T, l_b).T)
    # The rate of n against the Earth, up to 3e-6 rad/s, is left out here.
    np.testing.assert_allclose(v_m[0], drive.truth.speed_at(stamps), atol=5e-6)
    np.testing.assert_allclose(v_m[1:], 0.0, atol=5e-6)


def test_standing_still_is_gravity_and_the_earth() -> None:
    drive = run(scenario="static", **QUIET)
    w_b = drive.truth.C_nb_at(drive.truth.stamp_ns).T @ earth_rate_n(40.0 * DEG)
    np.testing.assert_allclose(drive.imu.w_ib_b - w_b[:, np.newaxis], 0.0, atol=1e-18)
    np.testing.assert_allclose(np.linalg.norm(drive.imu.f_ib_b, axis=0), 9.80155, atol=1e-5)


@pytest.mark.parametrize("rate_hz", [1.0, 10.0, 200.0])
def test_mean_sampling_is_the_mean(rate_hz: float) -> None:
    track = run().truth.track
    begin = np.linspace(20.0, 100.0, 40)
    w, f = track.sense_mean(begin, begin + 1.0 / rate_hz)
    part = (np.arange(1000) + 0.5) / 1000 / rate_hz
    w_fine, f_fine = track.sense((begin[:, np.newaxis] + part).ravel())
    np.testing.assert_allclose(w, w_fine.reshape(3, -1, 1000).mean(axis=2), atol=1e-7)
    np.testing.assert_allclose(f, f_fine.reshape(3, -1, 1000).mean(axis=2), atol=1e-6)


def test_gradients_of_sideslip_and_suspension() -> None:
    gradients = {
        "sideslip_deg_per_m_s2": 0.15,
        "suspension_roll_deg_per_m_s2": 0.3,
        "suspension_pitch_deg_per_m_s2": 0.2,
    }
    drive = run(**{**QUIET, **gradients}, odometer_lever_arm_m=(0, 0, 0), ground_roll_deg=0.0)
    stamps = drive.imu.stamp_ns
    truth = drive.truth
    moving = truth.speed_at(stamps) > 1.0
    v_n = truth.v_n_at(stamps)
    a_n = np.gradient(v_n, 0.1, axis=1)[:, moving]
    along = v_n[:, moving] / np.linalg.norm(v_n[:, moving], axis=0)
    forward = np.sum(along * a_n, axis=0)
    lateral = a_n[0] * along[1] - a_n[1] * along[0]  # to the right
    d = travel_in_vehicle(drive, stamps[moving])
    C_bm = Rotation.from_euler("xyz", SHORT.mounting_rpy_deg, degrees=True).as_matrix()
    up_m = C_bm.T @ truth.C_nb_at(stamps[moving])[2]

    def slope(y: Array, x: Array) -> float:
        return float(x @ y / (x @ x)) / DEG

    # The nose points inwards and up, so travel is outwards (left in a right turn) and down.
    assert slope(d[1], lateral) == pytest.approx(0.15, rel=0.02)
    assert slope(d[2], forward) == pytest.approx(-0.2, rel=0.02)
    # Leaning left in a right turn: up, in vehicle axes, goes right. REP-103 roll < 0.
    assert slope(np.arctan2(up_m[1], up_m[2]), lateral) == pytest.approx(-0.3, rel=0.02)


def test_direction_noise() -> None:
    drive = run(
        scenario="straight", duration_s=600.0, **{**QUIET, "direction_noise_deg": 0.05},
        odometer_lever_arm_m=(0, 0, 0),
    )  # fmt: skip
    stamps = drive.imu.stamp_ns[200:]
    d = travel_in_vehicle(drive, stamps)
    for angle, lags in ((d[1], 20), (d[2], 10)):
        assert angle.std() / DEG == pytest.approx(0.05, rel=0.15)
        # A correlation of 1/e after 2 and 1 s.
        correlation = np.mean(angle[lags:] * angle[:-lags]) / np.var(angle)
        assert correlation == pytest.approx(math.exp(-1.0), abs=0.2)


def test_road_motion_is_there_when_driving_only() -> None:
    drive = run(scenario="straight", **{**QUIET, "road_motion_deg": 0.1}, duration_s=300.0,
                ground_roll_deg=0.0, mounting_rpy_deg=(0, 0, 0))  # fmt: skip
    C_nb = drive.truth.C_nb_at(drive.imu.stamp_ns)
    roll = np.arctan2(C_nb[2, 1], C_nb[2, 2])
    assert np.abs(roll[:30]).max() < 1e-12
    assert roll[300:].std() / DEG == pytest.approx(0.1, rel=0.15)


def test_standing_motion() -> None:
    drive = run(scenario="static", **{**QUIET, "standing_motion_arcsec": 5.0}, duration_s=600.0)
    C_nb = np.moveaxis(drive.truth.C_nb_at(drive.imu.stamp_ns), -1, 0)
    turns = (Rotation.from_matrix(C_nb[0]).inv() * Rotation.from_matrix(C_nb)).as_rotvec()
    np.testing.assert_allclose(turns.std(axis=0) / ARCSEC, 5.0, rtol=0.15)


# --- scenarios ----------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("scenario", VEHICLE_SCENARIOS)
def test_drives_are_what_a_vehicle_can_do(scenario: str, seed: int) -> None:
    route = run(scenario=scenario, seed=seed).truth.track.motion
    way = route.way(np.arange(0.0, 120.0, 0.05))
    speed = way.distance[1]
    assert np.abs(speed).max() < 18.5
    assert np.abs(way.distance[2]).max() < 3.0
    assert np.abs(speed * way.course[1]).max() < 2.9  # 12 m/s on a radius of 50 m
    assert np.abs(way.slope[0]).max() < 5.1 * DEG
    assert (speed[0] == 10.0) if scenario == "moving_start" else (speed[0] == 0.0)


def test_urban_turns_and_stops() -> None:
    motion = run(duration_s=600.0).truth.track.motion
    way = motion.way(np.arange(0.0, 600.0, 0.1))
    course, curvature = motion.route.curvature(way.distance[0])[:2]
    quarters = course[curvature == 0.0] / (0.5 * math.pi)
    np.testing.assert_allclose(quarters, np.rint(quarters), atol=1e-9)
    assert 10 <= np.count_nonzero(np.abs(np.diff(np.rint(quarters))) == 1.0) <= 30
    standing = way.distance[1] == 0.0
    assert standing[:80].all()
    assert np.count_nonzero(np.diff(standing.astype(int)) == 1) >= 2
    assert way.distance[1].max() > 10.0


def test_moving_start_turns_within_a_minute() -> None:
    for seed in range(5):
        motion = run(scenario="moving_start", seed=seed).truth.track.motion
        course = motion.way(np.arange(0.0, 60.0, 0.1)).course[0]
        assert np.ptp(course) > 80.0 * DEG


def test_reverse_goes_back_on_its_way() -> None:
    speed = run(scenario="reverse", duration_s=600.0).truth.track.motion.route.speed
    v = speed(np.arange(0.0, 600.0, 0.1))[1]
    backwards = v < 0.0
    assert 100.0 < 0.1 * np.count_nonzero(backwards) < 220.0
    assert v.min() > -5.1


def test_heading_and_ground() -> None:
    drive = run(scenario="ring", heading_deg=200.0, ground_roll_deg=3.0, ground_pitch_deg=-2.0,
                mounting_rpy_deg=(0, 0, 0), **QUIET)  # fmt: skip
    begin = drive.options.start_stamp_ns
    assert drive.truth.heading_at(begin) == pytest.approx(200.0 * DEG, abs=1e-3)
    still = run(scenario="static", heading_deg=200.0, ground_roll_deg=3.0, ground_pitch_deg=-2.0,
                mounting_rpy_deg=(0, 0, 0), **QUIET)  # fmt: skip
    yaw, pitch, roll = Rotation.from_matrix(still.truth.C_nb_at(begin)).as_euler(
        "ZYX", degrees=True
    )
    assert (roll, pitch) == pytest.approx((3.0, -2.0), abs=1e-9)
    assert (90.0 - yaw) % 360.0 == pytest.approx(200.0, abs=1e-9)


def test_random_heading_differs_by_seed() -> None:
    headings = [
        float(run(seed=seed, duration_s=1.0).truth.heading_at(SHORT.start_stamp_ns))
        for seed in range(8)
    ]
    assert np.ptp(headings) > 1.0


# --- the run ------------------------------------------------------------------------------


def test_truth_dict() -> None:
    truth = run(odometer_latency_s=0.1, duration_s=5.0).truth
    content = json.loads(json.dumps(truth.truth_dict(), allow_nan=False))
    assert list(content) == [
        "q_nb_wxyz", "stamp_ns", "lever_arm_m", "latitude_deg", "longitude_deg", "altitude_m",
        "gyro_bias_rad_s", "accel_bias_m_s2", "odometer_scale_error", "seed", "scenario", "grade",
        "rate_hz", "sampling", "odometer_lever_arm_m", "mounting_rpy_deg", "odometer_latency_s",
    ]  # fmt: skip
    assert content["lever_arm_m"] is None
    assert content["odometer_lever_arm_m"] == [0.3, 1.2, -0.5]
    assert content["mounting_rpy_deg"] == [2.0, -3.0, 50.0]
    assert content["odometer_latency_s"] == 0.1
    w, x, y, z = content["q_nb_wxyz"]
    np.testing.assert_allclose(
        Rotation.from_quat([x, y, z, w]).as_matrix(), truth.C_nb_at(truth.stamp_ns), atol=1e-14
    )


def test_truth_at_one_and_at_many_stamps() -> None:
    drive = run(duration_s=5.0)
    truth, stamps = drive.truth, drive.imu.stamp_ns[[0, 7, -1]]
    for function, shape in (
        (truth.C_nb_at, (3, 3)), (truth.v_n_at, (3,)), (truth.position_at, (3,)),
        (truth.heading_at, ()), (truth.speed_at, ()), (truth.distance_at, ()),
    ):  # fmt: skip
        many = function(stamps)
        assert many.shape == (*shape, 3)
        for k, stamp in enumerate(stamps):
            one = function(int(stamp))
            assert np.shape(one) == shape
            np.testing.assert_allclose(one, many[..., k], atol=1e-14)
    with pytest.raises(ValueError, match="covers"):
        truth.position_at(truth.stamp_ns + 10**10)


def test_start_is_where_it_was_asked_for() -> None:
    drive = run(latitude_deg=-33.0, longitude_deg=151.0, altitude_m=12.0, duration_s=2.0)
    place = drive.truth.position_at(SHORT.start_stamp_ns)
    np.testing.assert_allclose(place, [-33.0 * DEG, 151.0 * DEG, 12.0], atol=1e-13)


def test_chunks_are_the_run() -> None:
    drive = run(duration_s=20.0)
    pieces = list(drive.chunks(0.7))
    assert len(pieces) == 29
    np.testing.assert_array_equal(
        np.concatenate([imu.w_ib_b for imu, _ in pieces], axis=1), drive.imu.w_ib_b
    )
    np.testing.assert_array_equal(
        np.concatenate([odometer.speed for _, odometer in pieces]), drive.odometer.speed
    )


def test_same_seed_same_numbers() -> None:
    one, other = run(grade="fog"), run(grade="fog")
    for x, y in zip((*one.imu, *one.odometer), (*other.imu, *other.odometer), strict=True):
        np.testing.assert_array_equal(x, y)
    third = run(grade="fog", seed=8)
    assert not np.any(one.imu.w_ib_b == third.imu.w_ib_b)


@pytest.mark.parametrize(
    "changes",
    [
        {"road_motion_deg": 0.0},
        {"direction_noise_deg": 0.2},
        {"heading_deg": 10.0},
        {"ground_roll_deg": 0.0},
        {"latitude_deg": 10.0},
        {"grade": "tactical", "rate_hz": 20.0},
        {"odometer_lever_arm_m": (0.0, 0.0, 0.0)},
    ],
)
def test_other_options_keep_the_odometer(changes: dict[str, object]) -> None:
    for x, y in zip(run().odometer, run(**changes).odometer, strict=True):
        np.testing.assert_array_equal(x, y)


@pytest.mark.parametrize(
    "changes",
    [
        {"slip_count": 4},
        {"odometer_quantum_m": 0.0},
        {"odometer_noise_m_s": 0.1},
        {"outlier_fraction": 0.1},
        {"odometer_rate_hz": 7.0},
        {"unsigned_wheel": True},
        {"odometer_scale_error": 0.1},
    ],
)
def test_the_odometer_keeps_the_imu(changes: dict[str, object]) -> None:
    for x, y in zip(run(grade="fog").imu, run(grade="fog", **changes).imu, strict=True):
        np.testing.assert_array_equal(x, y)


def test_a_longer_run_begins_alike() -> None:
    for scenario in VEHICLE_SCENARIOS:
        short, long = run(scenario=scenario), run(scenario=scenario, duration_s=300.0)
        stamps = short.imu.stamp_ns
        np.testing.assert_array_equal(short.truth.C_nb_at(stamps), long.truth.C_nb_at(stamps))


def test_losses_and_jitter() -> None:
    whole = run(rate_hz=50.0)
    damaged = run(rate_hz=50.0, lost_fraction=0.1, stamp_jitter_s=1e-3)
    assert 0.05 < 1.0 - len(damaged.imu) / len(whole.imu) < 0.15
    assert np.diff(damaged.imu.stamp_ns).min() > 0
    assert damaged.truth.stamp_ns == damaged.imu.stamp_ns[-1]


# --- settings -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"scenario": "boat"}, "scenario"),
        ({"grade": "gold"}, "imu_grade"),
        ({"sampling": "median"}, "sampling"),
        ({"rate_hz": 0.0}, "rate_hz"),
        ({"odometer_rate_hz": -1.0}, "odometer_rate_hz"),
        ({"duration_s": math.nan}, "duration_s"),
        ({"duration_s": 0.001}, "duration_s"),
        ({"latitude_deg": 90.0}, "latitude_deg"),
        ({"heading_deg": math.inf}, "heading_deg"),
        ({"odometer_lever_arm_m": (1.0, 2.0)}, "odometer_lever_arm_m"),
        ({"mounting_rpy_deg": (1.0, 2.0, math.nan)}, "mounting_rpy_deg"),
        ({"lost_fraction": 1.0}, "lost_fraction"),
        ({"outlier_fraction": -0.1}, "outlier_fraction"),
        ({"stamp_jitter_s": 1.0}, "stamp_jitter_s"),
        ({"odometer_quantum_m": -0.01}, "odometer_quantum_m"),
        ({"odometer_clock_drift": 0.5}, "odometer_clock_drift"),
        ({"slip_count": -1}, "slip_count"),
        ({"dropouts": ((1.0,),)}, "dropouts"),
        ({"stuck": ((1.0, -1.0),)}, "stuck"),
        ({"scale_step": (100.0, -1.0)}, "scale_step"),
        ({"seed": -1}, "seed"),
    ],
)
def test_settings_that_cannot_be(changes: dict[str, object], name: str) -> None:
    with pytest.raises(ValueError, match=f"^{name}: "):
        dataclasses.replace(SHORT, **changes)


def test_not_over_the_pole() -> None:
    with pytest.raises(ValueError, match="pole"):
        run(scenario="straight", latitude_deg=89.94, heading_deg=0.0, duration_s=600.0)
