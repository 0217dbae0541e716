"""Gyros of a vehicle noisier than declared: the likelihood itself, and what it says of drives."""

from __future__ import annotations

import copy
import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from odo_sessions import config_of, vehicle
from scipy.stats import binom, multivariate_normal

from sins_align.noise_doubt import DOUBTED, FACTOR
from sins_align.odo.aligner import OdoAligner
from sins_align.odo.distribution import Taken
from sins_align.odo.epoch import AidedEpoch
from sins_align.odo.error_model import ErrorModel, ImuNoise
from sins_align.odo.filter import GAP_INDEX, Step
from sins_align.odo.imu_model import imu_noise
from sins_align.odo.layout import ODOMETER, PHI, SIZE, VELOCITY
from sins_align.odo.loudness import Loudness
from sins_align.odo.odometer_model import OdometerModel
from sins_align.odo.pairing import Paired
from sins_align.odo.standing import Standing
from sins_align.odo.wander import WanderFilter
from sins_align.rotation import log_rotation
from sins_align.session import Session
from sins_align.simulate import VehicleOptions, VehicleRun, simulate_vehicle
from sins_align.types import Array

PATH_SIZE = SIZE + 3
RANDOM_NOISE = ImuNoise(0.1, 0.0, 0.0)
DRIVES = ("ring", "figure8", "static")


# -- the ratio is that of the densities


class RandomModel:
    """A linear model with random steps, and a Kalman filter of it that feeds back.

    steps : with their innovations; means : (K, n) of the open loop; z : (K, 3) measured
    """

    def __init__(self, seed: int, epochs: int) -> None:
        stream = np.random.default_rng(seed)
        self.P0 = np.eye(SIZE)
        self.steps: list[Step] = []
        self.z = np.full((epochs, 3), np.nan)
        P, mean = self.P0, np.zeros(SIZE)
        x = stream.standard_normal(SIZE)
        louder = ErrorModel(replace(RANDOM_NOISE, gyro=2.0 * RANDOM_NOISE.gyro), SIZE)
        for k in range(epochs):
            A = np.vstack((np.eye(SIZE), np.zeros((3, SIZE))))
            A += 0.1 * stream.standard_normal((PATH_SIZE, SIZE))
            Q = random_noise(stream)
            H, R = stream.standard_normal((3, PATH_SIZE)), np.diag(stream.uniform(0.1, 1.0, 3))
            gap = stream.uniform(0.1, 0.5, 6) if k % 4 == 1 else None
            noise = Q + louder.noise(1.0)
            x = A @ (x + gap_root(gap) @ stream.standard_normal(SIZE))
            x += stream.multivariate_normal(np.zeros(PATH_SIZE), noise, method="eigh")
            P = A @ (P + gap_root(gap) ** 2) @ A.T + Q
            mean = A @ mean
            taken = None
            if k % 5 != 3:
                self.z[k] = H @ x + np.sqrt(R.diagonal()) * stream.standard_normal(3)
                S = H @ P @ H.T + R
                K, value = P @ H.T @ np.linalg.inv(S), self.z[k] - H @ mean
                taken = Taken(value, S, R, (K @ value)[:SIZE], None)
                mean, P = mean + K @ value, P - K @ S @ K.T
            self.steps.append(Step(1.0, A, Q, H, R, gap, taken))
            x, mean, P = x[:SIZE], mean[:SIZE], P[:SIZE, :SIZE]

    def log_density(self, more: Array) -> float:
        """Of all that was measured as one vector; more : (n + 3, n + 3) noise beyond Q."""
        spread, crosses, rows = self.P0, [], []
        measured = [k for k, step in enumerate(self.steps) if step.taken is not None]
        for step in self.steps:
            spread = step.A @ (spread + gap_root(step.gap) ** 2) @ step.A.T + step.Q + more
            crosses = [step.A @ cross for cross in crosses]
            if step.taken is not None:
                before = [step.H @ cross for cross in crosses]
                rows.append([*before, step.H @ spread @ step.H.T + step.R])
                crosses.append(spread @ step.H.T)
            spread, crosses = spread[:SIZE, :SIZE], [cross[:SIZE] for cross in crosses]
        V = np.zeros((3 * len(rows), 3 * len(rows)))
        for k, row in enumerate(rows):
            for j, block in enumerate(row):
                V[3 * k : 3 * k + 3, 3 * j : 3 * j + 3] = block
                V[3 * j : 3 * j + 3, 3 * k : 3 * k + 3] = block.T
        return float(multivariate_normal(np.zeros(V.shape[0]), V).logpdf(self.z[measured].ravel()))


def random_noise(stream: np.random.Generator) -> Array:
    B = 0.1 * stream.standard_normal((PATH_SIZE, PATH_SIZE))
    return B @ B.T


def gap_root(gap: Array | None) -> Array:
    root = np.zeros((SIZE, SIZE))
    if gap is not None:
        root[GAP_INDEX, GAP_INDEX] = np.sqrt(gap)
    return root


def fake_filter(P: Array) -> Any:
    """What the test of the noise sees of a filter."""
    return SimpleNamespace(P=P, nis=0.0, step=None, scaled=1.0, hand_over=None)


@pytest.mark.parametrize("seed", range(3))
def test_the_ratio_is_that_of_the_whole_vectors_densities(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing is implausible: what is made of that is not linear."""
    monkeypatch.setattr("sins_align.odo.loudness.SOFT_LIMIT", math.inf)
    model = RandomModel(seed, 30)
    filter_ = fake_filter(model.P0)
    loudness = Loudness(cast("WanderFilter", filter_), RANDOM_NOISE)
    for step in model.steps:
        filter_.step = step
        if step.taken is not None:
            filter_.nis = float(step.taken.value @ np.linalg.solve(step.taken.S, step.taken.value))
        loudness.follow()
    more = ErrorModel(ImuNoise(RANDOM_NOISE.gyro * math.sqrt(FACTOR**2 - 1.0), 0.0, 0.0), SIZE)
    nothing = np.zeros((PATH_SIZE, PATH_SIZE))
    expected = model.log_density(more.noise(1.0)) - model.log_density(nothing)
    assert abs(expected) > 0.1
    assert loudness.log_ratio == pytest.approx(expected, abs=1e-6)


# -- in a drive


def session_until(time_s: float, run: VehicleRun, **parameters: Any) -> Session:
    """A drive's session, `time_s` after its start."""
    session = Session(config_of(run, **parameters))
    add_until(session, time_s, run)
    return session


def add_until(session: Session, time_s: float, run: VehicleRun, from_s: float = -1.0) -> None:
    begin_ns, end_ns = (run.options.start_stamp_ns + round(t * 1e9) for t in (from_s, time_s))
    for samples, add in ((run.odometer, session.add_odometer), (run.imu, session.add_imu)):
        add(samples.select((samples.stamp_ns > begin_ns) & (samples.stamp_ns <= end_ns)))


def aligner_of(session: Session) -> OdoAligner:
    aligner = session._aligner
    assert isinstance(aligner, OdoAligner)
    return aligner


def loudness_of(session: Session) -> Loudness:
    loudness = aligner_of(session)._doubts._loudness
    assert loudness is not None
    return loudness


def estimates_apart(one: WanderFilter, other: WanderFilter) -> Array:
    """(n,) of two azimuth states: the errors of the one, if the other were the truth."""
    dx = np.zeros(SIZE)
    dx[PHI] = -log_rotation(one.navigation.C_ab @ other.navigation.C_ab.T)
    dx[VELOCITY] = one.navigation.v_a - other.navigation.v_a
    sensors, others = one.sensors, other.sensors
    dx[6:9] = others.gyro_bias - sensors.gyro_bias
    dx[9:12] = others.accel_bias - sensors.accel_bias
    dx[12:15] = others.gyro_turn - sensors.gyro_turn
    dx[ODOMETER] = one.odometer.x - other.odometer.x
    dx[29:31] = (one.navigation.e_a - other.navigation.e_a)[:2]
    return dx


def test_it_is_a_filter_with_its_own_navigation(monkeypatch: pytest.MonkeyPatch) -> None:
    """From 20 s on a real one runs beside it."""
    monkeypatch.setattr(OdometerModel, "adapt", lambda *_: None)  # R is that of the first
    run = vehicle("ring", 300.0, grade="tactical")
    session = session_until(20.0, run, method="wander_kf")
    aligner = aligner_of(session)
    first = aligner._wander
    assert first is not None
    other = copy.deepcopy(first)
    noise = imu_noise(run.options.imu_grade)
    other._model = ErrorModel(replace(noise, gyro=FACTOR * noise.gyro), SIZE)
    loudness = aligner._doubts._loudness = Loudness(first, noise)
    process, added = aligner._process, []

    def log_density(filter_: WanderFilter) -> float:
        assert filter_.step is not None and filter_.step.taken is not None
        return -0.5 * (float(np.linalg.slogdet(filter_.step.taken.S)[1]) + filter_.nis)

    def both(paired: Paired, delay: float) -> tuple[bool, AidedEpoch]:
        bias = other.bias(paired.block.w_ib_b)
        other.process(aligner._integrate(other, paired, delay, bias), Standing.NO)
        result = process(paired, delay)
        added.append(log_density(other) - log_density(first))
        return result

    aligner._process = both  # type: ignore[method-assign]
    add_until(session, 80.0, run, 20.0)
    assert not first.one_azimuth and not other.one_azimuth
    sigma = np.sqrt(other.P.diagonal())
    apart = estimates_apart(first, other) / sigma
    assert np.abs(apart).max() > 0.1
    np.testing.assert_allclose(loudness.mean / sigma, apart, atol=0.01)
    np.testing.assert_allclose(np.sqrt(loudness.P.diagonal()) / sigma, 1.0, atol=0.01)
    assert abs(sum(added)) > 0.5
    assert loudness.log_ratio == pytest.approx(sum(added), rel=0.02)


@pytest.mark.parametrize("scenario", DRIVES)
def test_with_the_same_noise_it_is_the_same_filter(
    scenario: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever the guards do, and when the azimuth is handed over."""
    monkeypatch.setattr("sins_align.odo.loudness.FACTOR", 1.0)
    loudness = loudness_of(session_until(150.0, vehicle(scenario, 300.0)))
    first = loudness.filter
    assert first.one_azimuth
    sigma = np.sqrt(np.maximum(first.P.diagonal(), 1e-30))
    np.testing.assert_allclose(loudness.mean / sigma, 0.0, atol=0.02)
    np.testing.assert_allclose(np.sqrt(loudness.P.diagonal())[:30] / sigma[:30], 1.0, atol=0.02)
    assert loudness.log_ratio == pytest.approx(0.0, abs=0.02)


def test_a_filter_that_begins_anew_begins_another_test() -> None:
    run = vehicle("ring", 300.0)
    session = session_until(60.0, run)
    aligner, before = aligner_of(session), loudness_of(session)
    before.note(2.0 * DOUBTED)
    assert [f.reason.key for f in aligner._doubts_now()] == ["gyro_noisy"]
    aligner._begin()
    assert not aligner._doubts_now()
    add_until(session, 80.0, run, 60.0)
    assert loudness_of(session) is not before and loudness_of(session).log_ratio < DOUBTED


def test_without_a_wander_filter_there_is_no_test() -> None:
    aligner = aligner_of(session_until(120.0, vehicle("ring", 300.0), coarse="inertial"))
    assert aligner._wander is None and aligner._large is not None
    assert aligner._doubts._loudness is None


# -- what it says


def is_doubted(seed: int, factor: float) -> bool:
    """Whether the noise is, at any time of a session."""
    options = VehicleOptions(
        scenario=DRIVES[seed % 3], grade="fog", seed=seed, rate_hz=100.0, duration_s=300.0
    )
    declared = options.imu_grade
    noisy = replace(declared, gyro_arw=factor * declared.gyro_arw)
    run = simulate_vehicle(replace(options, grade=noisy))
    session = Session(config_of(run, imu_grade="fog"))
    updates = session.add_odometer(run.odometer) + session.add_imu(run.imu)
    return any("gyro_noisy" in update.status.keys for update in updates)


def test_true_noise_is_seldom_doubted_and_six_times_as_much_mostly_is() -> None:
    """Ville: in one run of thirty at most; in 12 runs 4 and more are then one in 2000."""
    assert binom.sf(3, 12, np.exp(-DOUBTED)) < 1e-3
    assert sum(is_doubted(seed, 1.0) for seed in range(12)) <= 3
    assert sum(is_doubted(seed, 6.0) for seed in range(12)) >= 10
