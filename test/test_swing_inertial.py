"""The inertial-frame method as a whole: accuracy, honesty of sigma, what it refuses to claim.

The statistics are those of a few seeds, with two-sided bounds wide enough for them; the long
runs are `make evidence`.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from evidence.monte_carlo import Outcome, misalignment_of, monte_carlo, run
from sins_align.config import swing_config
from sins_align.grades import load_grade
from sins_align.ros.bags import open_bag
from sins_align.rotation import dcm_from_quaternion, heading_from_yaw, rpy_from_dcm
from sins_align.session import Session
from sins_align.simulate import SCENARIOS, SwingOptions, simulate_swing, swing
from sins_align.simulate.sensors import SensorErrors
from sins_align.types import ImuSamples, State
from sins_align.units import ARCMIN, ARCSEC, DEG

RIGID = {"position_noise_m": 1e-6}
RECORDING = Path(__file__).resolve().parents[2] / "shared" / "data" / "lasergyro_a"
PITCH = SwingOptions(scenario="pitch", rate_hz=100.0)
SEEDS = 10
MICROMETRE = 1e-6


def heading_nees_bounds(runs: int) -> tuple[float, float]:
    """Two-sided 99.9 % bounds of the mean of `runs` squared standard normals."""
    low, high = chi2.ppf([0.0005, 0.9995], runs) / runs
    return float(low), float(high)


def assert_honest_heading(outcomes: list[Outcome]) -> None:
    nees = np.mean([(o.misalignment[2] / o.sigma[2]) ** 2 for o in outcomes])
    low, high = heading_nees_bounds(len(outcomes))
    assert low < nees < high


@pytest.fixture(scope="module")
def rigid() -> list[Outcome]:
    return monte_carlo(PITCH, RIGID, range(SEEDS))


def test_reaches_the_bound_on_a_rigid_centre(rigid: list[Outcome]) -> None:
    """Paper's noise, 420 s. Bounds: those of the README, for the RMS of ten runs."""
    phi = np.sqrt(np.mean([o.misalignment**2 for o in rigid], axis=0))
    lever = np.sqrt(np.mean([o.lever_error**2 for o in rigid], axis=0))
    assert phi[:2].max() < 6e-6 * DEG
    assert phi[2] < 4e-4 * DEG
    assert lever.max() < 10.0 * MICROMETRE


@pytest.mark.parametrize(
    ("scenario", "grade"), [("still", "rlg"), ("pitch", "rlg"), ("erect", "fog_noisy")]
)
def test_sigma_of_the_levels_is_what_the_biases_do(
    scenario: str, grade: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One axis after the other off by its declared sigma, and nothing else wrong.

    The squares of what that does to the levels add up to P, with no luck of a draw in it.
    """
    options = SwingOptions(
        scenario=scenario, grade="perfect", rate_hz=50.0, duration_s=61.0, heading_deg=20.0
    )
    total, P = np.zeros((3, 3)), np.eye(3)
    for axis in np.eye(3):
        errors = SensorErrors(
            np.zeros(3), load_grade(grade).accel_bias * axis, np.eye(3), np.eye(3)
        )
        monkeypatch.setattr(swing, "draw_sensor_errors", lambda *_, errors=errors: errors)
        outcome = run(options, {"imu_grade": grade})
        total += np.outer(outcome.misalignment, outcome.misalignment)
        P = outcome.covariance
    ratio = np.linalg.solve(P[:2, :2], total[:2, :2])
    np.testing.assert_allclose(ratio, np.eye(2), atol=0.02)


def test_sigma_is_that_of_theory(rigid: list[Outcome]) -> None:
    """sigma_heading^2 = 12 VRW^2 / (g W cos L)^2 T^3, sigma_north = VRW / (g sqrt T)."""
    grade = swing_config({"imu_grade": "paper_swing"}).grade
    g, W_cos, T = 9.80, 7.292115e-5 * np.cos(40.0 * DEG), 420.0
    heading = np.sqrt(12.0 / T**3) * grade.accel_vrw / (g * W_cos)
    north = grade.accel_vrw / (g * np.sqrt(T))
    assert rigid[0].sigma[2] == pytest.approx(heading, rel=0.03)
    assert rigid[0].sigma[1] == pytest.approx(north, rel=0.03)
    assert rigid[0].sigma[0] == pytest.approx(2.0 * north, rel=0.05)


def test_heading_sigma_is_honest(rigid: list[Outcome]) -> None:
    assert_honest_heading(rigid)


@pytest.mark.parametrize(
    ("grade", "scenario"),
    [("tactical", "erect"), ("fog", "erect"), ("rlg", "still"), ("tactical", "pitch")],
)
def test_sigma_is_honest_for_real_sensors(grade: str, scenario: str) -> None:
    """On the cone the scale errors rectify: without them as unknowns fog has a NEES of 10."""
    options = replace(PITCH, grade=grade, scenario=scenario, duration_s=180.0)
    runs = 2 * SEEDS
    outcomes = monte_carlo(options, {}, range(runs))
    assert_honest_heading(outcomes)
    low, high = chi2.ppf([0.0005, 0.9995], 3 * runs) / (3 * runs)
    assert low < np.mean([o.nees for o in outcomes]) / 3.0 < high


@pytest.mark.parametrize("heading", [90.0, 180.0, 270.0])
def test_any_heading_is_as_good(heading: float, rigid: list[Outcome]) -> None:
    (turned,) = monte_carlo(replace(PITCH, heading_deg=heading), RIGID, [0])
    assert abs(turned.misalignment[2]) < 1e-3 * DEG
    assert turned.sigma == pytest.approx(rigid[0].sigma, rel=0.02)


def test_interval_means_are_as_good() -> None:
    outcomes = monte_carlo(replace(PITCH, sampling="mean"), RIGID, range(4))
    assert max(abs(o.misalignment[2]) for o in outcomes) < 1e-3 * DEG
    assert max(np.abs(o.lever_error).max() for o in outcomes) < 30.0 * MICROMETRE


def test_lost_samples_cost_little() -> None:
    outcomes = monte_carlo(replace(PITCH, lost_fraction=0.01), RIGID, range(4))
    assert max(abs(o.misalignment[2]) for o in outcomes) < 1e-3 * DEG


def test_heave_is_noticed_and_covered() -> None:
    """3 cm of heave against a floor of 1 mm: the noise has to grow by itself."""
    outcomes = monte_carlo(replace(PITCH, heave_m=0.03), {}, range(6))
    for outcome in outcomes:
        assert abs(outcome.misalignment[2]) < 2e-3 * DEG
        assert abs(outcome.misalignment[2]) < 3.0 * outcome.sigma[2]
        assert (
            np.abs(outcome.lever_error) < 4.0 * np.sqrt(np.diag(outcome.lever_covariance))
        ).all()
        assert 0.5 < outcome.consistency < 2.0


def test_single_axis_flags_the_lost_direction() -> None:
    (outcome,) = monte_carlo(replace(PITCH, scenario="single_axis"), RIGID, [1])
    assert outcome.lever_observable == (False, True, True)
    assert abs(outcome.misalignment[2]) < 5e-4 * DEG * 2
    assert np.sqrt(outcome.lever_covariance[0, 0]) > 1.0
    assert np.abs(outcome.lever_error[1:]).max() < 30.0 * MICROMETRE


def test_still_base_claims_no_lever_arm() -> None:
    (outcome,) = monte_carlo(replace(PITCH, scenario="still", grade="tactical"), {}, [1])
    assert outcome.lever_observable == (False, False, False)


def test_a_turn_of_the_base_finds_the_gyro_bias() -> None:
    still = replace(PITCH, grade="tactical", duration_s=240.0)
    (straight,) = monte_carlo(still, {}, [2])
    turned = monte_carlo(replace(still, turn_deg=90.0), {}, range(SEEDS))
    assert turned[0].sigma[2] < 0.5 * straight.sigma[2]
    assert_honest_heading(turned)


def test_no_false_information_in_a_long_run() -> None:
    """A bias of 1 deg/h limits heading to 5 deg for ever: sigma must not sink below that."""
    options = replace(PITCH, scenario="still", grade="tactical", duration_s=900.0, rate_hz=50.0)
    outcomes = monte_carlo(options, {}, range(500, 506))
    for outcome in outcomes:
        assert abs(outcome.misalignment[2]) < 4.0 * outcome.sigma[2]
        assert outcome.sigma[2] > 4.8 * DEG


@pytest.mark.parametrize("amplitude_deg", [0.05, 0.35])
def test_a_weak_swing_tells_the_lever_arm(amplitude_deg: float) -> None:
    """5 m of it, which is 4 mm or 3 cm of motion: after a minute heading is as on a still base."""
    weak = replace(SCENARIOS["level"], amplitude_deg=(amplitude_deg,) * 3)
    options = replace(PITCH, scenario=weak, grade="rlg", duration_s=60.0)
    still = monte_carlo(replace(options, scenario="still"), {}, range(1))[0]
    squares = []
    for outcome in monte_carlo(options, {}, range(6)):
        assert abs(outcome.misalignment[2]) < 4.0 * outcome.sigma[2]
        assert outcome.sigma[2] < 1.1 * still.sigma[2]
        assert outcome.lever_observable == (True, True, True)
        error, P = outcome.lever_error, outcome.lever_covariance
        assert np.sqrt(P.diagonal()).max() < 0.1
        squares.append(error @ np.linalg.solve(P, error))
    assert sum(squares) < chi2.isf(1e-3, 18)


@pytest.mark.parametrize(("grade", "ends_s"), [("rlg", 33.0), ("tactical", 60.0)])
def test_a_weak_swing_is_named_and_a_strong_one_not(grade: str, ends_s: float) -> None:
    """While the lever arm is considered, and with noisy gyros for longer."""
    for amplitude_deg in (0.3, 2.0):
        scenario = replace(SCENARIOS["level"], amplitude_deg=(amplitude_deg,) * 3)
        options = replace(PITCH, scenario=scenario, grade=grade, duration_s=60.0, rate_hz=50.0)
        session = Session(swing_config({"latitude_deg": 40.0, "imu_grade": grade}))
        samples = simulate_swing(options).imu
        said = [
            (u.stamp_ns - samples.stamp_ns[0]) * 1e-9
            for u in session.add_imu(samples)
            if "swing_weak" in u.status.keys
        ]
        if amplitude_deg < 1.0:
            assert said and max(said) <= ends_s
        else:
            assert not said


@pytest.mark.parametrize("sigma_m", [0.0, 0.001])
def test_a_lever_arm_that_is_given_is_known(sigma_m: float) -> None:
    lever = (1.0, -0.5, 0.8)
    options = replace(PITCH, grade="rlg", duration_s=60.0, rate_hz=50.0, lever_arm_m=lever)
    prior = {"lever_arm_prior_m": list(lever), "lever_arm_prior_sigma_m": sigma_m}
    (outcome,) = monte_carlo(options, prior, range(1))
    assert outcome.lever_observable == (True, True, True)
    assert np.abs(outcome.lever_error).max() <= 4.0 * sigma_m


def test_a_slow_heave_is_covered() -> None:
    """20 cm in a period of a minute, under a floor of half a millimetre."""
    options = replace(PITCH, grade="rlg", scenario="still", heave_m=0.2, heave_period_s=60.0)
    for outcome in monte_carlo(options, {}, range(4)):
        assert (np.abs(outcome.misalignment) < 5.0 * outcome.sigma).all()


@pytest.mark.parametrize("latitude", [-35.0, 75.0])
def test_latitudes(latitude: float) -> None:
    outcomes = monte_carlo(replace(PITCH, latitude_deg=latitude), RIGID, range(3))
    assert max(abs(o.misalignment[2] / o.sigma[2]) for o in outcomes) < 4.0


def test_coarse_attitude_within_30_s() -> None:
    run = simulate_swing(replace(PITCH, grade="rlg", duration_s=30.0))
    session = Session(swing_config({"latitude_deg": 40.0, "altitude_m": 50.0}))
    assert session.status.state is State.WAITING
    updates = session.add_imu(run.imu)
    estimate = session.estimate
    assert estimate is not None
    phi = misalignment_of(estimate, run.truth.C_nb_at(estimate.stamp_ns))
    assert abs(phi[2]) < 1.0 * DEG
    assert updates[0].estimate is None  # nothing is claimed in the first second
    assert (np.abs(phi) < 4.0 * estimate.sigma).all()


def test_conclusion_uses_what_the_cycle_left() -> None:
    run = simulate_swing(replace(PITCH, duration_s=57.3))
    session = Session(swing_config({"latitude_deg": 40.0, **RIGID, "imu_grade": "paper_swing"}))
    session.add_imu(run.imu)
    before, conclusion, after = session.estimate, session.conclusion, session.estimate
    assert before is not None and conclusion is not None and after is not None
    assert conclusion.sigma[2] < before.sigma[2]
    assert conclusion.stamp_ns == before.stamp_ns == run.truth.stamp_ns
    assert np.array_equal(before.q_nb, after.q_nb)


@pytest.fixture(scope="module")
def recording() -> ImuSamples:
    if not RECORDING.exists():
        pytest.skip(f"the recording {RECORDING.name} is not here")
    with open_bag([RECORDING]) as bag:
        parts = list(bag.read_imu(bag.find_topic("imu").name))
    return ImuSamples(
        np.concatenate([p.stamp_ns for p in parts]),
        np.concatenate([p.w_ib_b for p in parts], axis=1),
        np.concatenate([p.f_ib_b for p in parts], axis=1),
    )


def align_recording(
    recording: ImuSamples, start_s: float
) -> tuple[Session, list[float], list[float]]:
    """300 s from start_s on: the session, the times of its updates, and their headings."""
    t = (recording.stamp_ns - recording.stamp_ns[0]) * 1e-9
    session = Session(
        swing_config(
            {
                "latitude_deg": 34.246048,
                "longitude_deg": 108.909664,
                "altitude_m": 380.0,
                "imu_grade": "rlg_parked",
                "imu_sampling": "mean",
            }
        )
    )
    part = recording.select((t >= start_s) & (t <= start_s + 300.0))
    updates = [u for u in session.add_imu(part) if u.estimate is not None]
    first = int(part.stamp_ns[0])
    times = [(u.stamp_ns - first) * 1e-9 for u in updates]
    return session, times, [heading(u.estimate.q_nb) for u in updates if u.estimate is not None]


def heading(q_nb: np.ndarray) -> float:
    return heading_from_yaw(rpy_from_dcm(dcm_from_quaternion(q_nb))[2])


def test_real_laser_gyro(recording: ImuSamples) -> None:
    """Against eight established methods: 90.60 deg, 0.8037 deg, 0.3106 deg (paper axes)."""
    session, times, headings = align_recording(recording, 0.0)
    estimate = session.conclusion
    assert estimate is not None and estimate.lever_arm is not None
    error = heading(estimate.q_nb) - 90.60 * DEG
    assert abs(error) < 1.5 * ARCMIN
    assert abs(error) < 3.0 * estimate.sigma[2]
    C_nb = dcm_from_quaternion(estimate.q_nb)
    # Right-forward-up: x = -y_FLU, y = x_FLU; pitch about x, roll about y.
    pitch = np.arcsin(C_nb[2, 0])
    roll = np.arctan2(C_nb[2, 1], C_nb[2, 2])
    assert abs(pitch - 0.8037 * DEG) < 10.0 * ARCSEC
    assert abs(roll - 0.3106 * DEG) < 10.0 * ARCSEC
    assert session.status.state is State.ALIGNED
    assert estimate.lever_arm.observable == (True, True, True)
    late = [abs(h - headings[-1]) for t, h in zip(times, headings, strict=True) if t >= 130.0]
    assert max(late) < 3.0 * ARCMIN


def test_real_laser_gyro_windows(recording: ImuSamples) -> None:
    """People and wind sway it about a centre 1 m away, which every window finds again."""
    headings, levers = [], []
    for start in range(0, 241, 30):
        conclusion = align_recording(recording, float(start))[0].conclusion
        assert conclusion is not None and conclusion.lever_arm is not None
        headings.append(heading(conclusion.q_nb))
        levers.append(conclusion.lever_arm)
    first, last = levers[0], levers[-1]  # a minute of 540 s is in both
    sigma = np.sqrt((first.covariance + last.covariance).diagonal())
    assert (np.abs(first.r_b - last.r_b) < 3.0 * sigma).all()
    assert max(np.sqrt(lever.covariance.diagonal()).max() for lever in levers) < 0.4
    assert np.std(headings, ddof=1) < 1.0 * ARCMIN
    assert np.ptp(headings) < 3.3 * ARCMIN
