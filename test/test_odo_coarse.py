"""Coarse alignment of a moving vehicle: accuracy, honesty of sigma, what the odometer may do."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import pytest
from scipy.stats import chi2

from sins_align.config import odo_config
from sins_align.odo.coarse import CoarseAligner, CoarseAttitude
from sins_align.odo.coarse_solution import find_rotation, heading_variance
from sins_align.odo.coarse_transition import transition
from sins_align.odo.epoch import AidedEpoch, Travel, integrate_epoch
from sins_align.odo.pairing import Pairing
from sins_align.rotation import dcm_from_rpy, log_rotation, unskew
from sins_align.simulate.vehicle import simulate_vehicle
from sins_align.simulate.vehicle_options import VehicleOptions
from sins_align.types import Array, ImuBlock
from sins_align.units import ARCMIN, DEG

SEEDS = 8
RATE_HZ = 100.0
QUIET = {"direction_noise_deg": 0.0, "standing_motion_arcsec": 0.0, "odometer_quantum_m": 0.0}
# No gradients and no scale error either: nothing but the motion itself.
IDEAL = {
    **QUIET,
    "grade": "perfect",
    "odometer_scale_error": 0.0,
    "sideslip_deg_per_m_s2": 0.0,
    "suspension_pitch_deg_per_m_s2": 0.0,
    "rate_hz": 200.0,
    "odometer_rate_hz": 100.0,
}


@dataclass(frozen=True)
class Drive:
    """Epochs, whether the vehicle stands in them, and the true C_nb at their ends (3, 3, N)."""

    epochs: list[AidedEpoch]
    standing: list[bool]
    time_s: Array
    C_nb: Array


@dataclass(frozen=True)
class Outcome:
    phi: Array
    covariance: Array

    @property
    def sigma(self) -> Array:
        return np.sqrt(np.diag(self.covariance))


@lru_cache(maxsize=64)
def _drive(options: VehicleOptions) -> Drive:
    run = simulate_vehicle(options)
    pairing = Pairing(odo_config({"odometer_quantum_m": 0.01}).odometer)
    pairing.add_odometer(run.odometer)
    pairing.add_imu(ImuBlock(run.imu.stamp_ns, run.imu.w_ib_b, run.imu.f_ib_b))
    epochs, standing = [], []
    while (paired := pairing.next(0.0)) is not None:
        epochs.append(integrate_epoch(paired, options.imu_sampling))
        standing.append(bool(np.abs(run.truth.speed_at(paired.block.stamp_ns)).max() == 0.0))
    end = np.array([epoch.stamp_ns for epoch in epochs])
    return Drive(epochs, standing, (end - run.imu.stamp_ns[0]) * 1e-9, run.truth.C_nb_at(end))


def drive(scenario: str, duration_s: float, seed: int = 0, **changes: object) -> Drive:
    settings = {"rate_hz": RATE_HZ, **changes}
    options = VehicleOptions(scenario=scenario, seed=seed, duration_s=duration_s, **settings)
    return _drive(options)


def aligner(grade: str = "fog", latitude_deg: float = 40.0, **values: object) -> CoarseAligner:
    place = {"latitude_deg": latitude_deg, "altitude_m": 50.0}
    config = odo_config({"imu_grade": grade, **place, **values})
    assert config.position is not None
    return CoarseAligner(config.position, config.grade, config.odometer)


def misalignment(found: CoarseAttitude, C_nb: Array) -> Outcome:
    """phi of C_est = (I - [phi x]) C_nb; the level of up alone, whatever the heading."""
    D = found.C_nb @ C_nb.T
    phi = np.array([D[1, 2], -D[0, 2], -log_rotation(D)[2]])
    return Outcome(phi, found.covariance)


def align(
    data: Drive,
    times: tuple[float, ...],
    under: CoarseAligner | None = None,
    change: Callable[[float, AidedEpoch], AidedEpoch] = lambda t, epoch: epoch,
) -> list[Outcome]:
    """What there is at `times` [s]."""
    under = aligner() if under is None else under
    outcomes: list[Outcome] = []
    for k, (epoch, standing) in enumerate(zip(data.epochs, data.standing, strict=True)):
        under.add(change(data.time_s[k], epoch), standing)
        if len(outcomes) < len(times) and data.time_s[k] > times[len(outcomes)] - 0.5:
            found = under.attitude
            assert found is not None
            outcomes.append(misalignment(found, data.C_nb[:, :, k]))
    assert len(outcomes) == len(times)
    return outcomes


def rms(values: list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def assert_honest(nees: list[float], dimension: int = 1, margin: float = 2.0) -> None:
    """Two-sided 99.9 % bounds; `margin` for declared noise above the simulated one."""
    count = dimension * len(nees)
    low, high = chi2.ppf([0.0005, 0.9995], count) / len(nees)
    assert low / margin < np.mean(nees) < high


def heading_nees(outcome: Outcome) -> float:
    return float((outcome.phi[2] / outcome.sigma[2]) ** 2)


def level_nees(outcome: Outcome) -> float:
    level = outcome.phi[:2]
    return float(level @ np.linalg.solve(outcome.covariance[:2, :2], level))


@pytest.fixture(scope="module")
def ring() -> list[list[Outcome]]:
    times = (3.0, 5.0, 10.0, 60.0, 120.0, 180.0)
    return [align(drive("ring", 183.0, seed), times) for seed in range(SEEDS)]


@pytest.mark.parametrize(
    ("at", "bound"), [(3, 120.0 * ARCMIN), (4, 15.0 * ARCMIN), (5, 9.0 * ARCMIN)]
)
def test_heading_on_the_ring(ring: list[list[Outcome]], at: int, bound: float) -> None:
    """60, 120, 180 s: 1 degree is passed about the first."""
    assert rms([run[at].phi[2] for run in ring]) < bound
    assert_honest([heading_nees(run[at]) for run in ring])


@pytest.mark.parametrize(("at", "bound"), [(0, 2.0), (1, 2.0), (2, 4.0), (5, 0.2)])
def test_level_on_the_ring(ring: list[list[Outcome]], at: int, bound: float) -> None:
    """The vehicle pulls away after about 4 s: level from the first seconds on."""
    assert np.abs([run[at].phi[:2] for run in ring]).max() < 3.0 * bound * ARCMIN
    assert rms([x for run in ring for x in run[at].phi[:2]]) < bound * ARCMIN
    assert_honest([level_nees(run[at]) for run in ring], dimension=2, margin=8.0)


def test_standing() -> None:
    runs = [align(drive("static", 63.0, seed), (3.0, 60.0)) for seed in range(SEEDS)]
    assert rms([run[1].phi[2] for run in runs]) < 20.0 * ARCMIN
    assert_honest([heading_nees(run[1]) for run in runs])
    for at in (0, 1):
        assert rms([x for run in runs for x in run[at].phi[:2]]) < 0.6 * ARCMIN
        assert_honest([level_nees(run[at]) for run in runs], dimension=2, margin=8.0)


def test_standing_needs_no_odometer() -> None:
    data = drive("static", 63.0)
    with_it = align(data, (60.0,))[0]
    without = align(data, (60.0,), change=lambda _, epoch: epoch._replace(travel=None))[0]
    np.testing.assert_array_equal(without.phi, with_it.phi)


def test_moving_start() -> None:
    """At speed from the first sample on; the level first, then the heading."""
    runs = [align(drive("moving_start", 123.0, s), (6.0, 120.0)) for s in range(SEEDS)]
    assert rms([x for run in runs for x in run[0].phi[:2]]) < 4.0 * ARCMIN
    assert rms([run[1].phi[2] for run in runs]) < 30.0 * ARCMIN
    assert_honest([level_nees(run[0]) for run in runs], dimension=2, margin=8.0)
    assert_honest([heading_nees(run[1]) for run in runs])


@pytest.mark.parametrize("latitude_deg", [40.0, -60.0, 0.0])
def test_model_is_exact(latitude_deg: float) -> None:
    """Straight on for 3 km: Coriolis and the turning of gravity would cost degrees."""
    data = drive("straight", 243.0, latitude_deg=latitude_deg, **IDEAL)
    outcome = align(data, (240.0,), aligner("perfect", latitude_deg))[0]
    assert np.abs(outcome.phi[:2]).max() < 0.02 * ARCMIN
    assert abs(outcome.phi[2]) < 0.5 * ARCMIN


def test_silence_is_bridged() -> None:
    """30 s of driving that the odometer does not tell of: the way goes on all the same."""
    data = drive("straight", 243.0, latitude_deg=40.0, **IDEAL)
    outcome = align(data, (240.0,), aligner("perfect"), change=_silent)[0]
    assert np.abs(outcome.phi[:2]).max() < 0.02 * ARCMIN
    assert abs(outcome.phi[2]) < 0.5 * ARCMIN


@pytest.mark.parametrize("rpy_deg", [(180.0, 0.0, 0.0), (0.0, 90.0, 30.0), (-100.0, 20.0, 250.0)])
def test_any_attitude(rpy_deg: tuple[float, float, float]) -> None:
    """Upside down, nose down, on its side: the IMU in the vehicle, that is."""
    data = drive("ring", 93.0, seed=1, mounting_rpy_deg=rpy_deg)
    early, late = align(data, (5.0, 90.0), aligner(mounting_rpy_deg=list(rpy_deg)))
    assert np.abs(early.phi[:2]).max() < 4.0 * early.sigma[:2].max()
    assert np.abs(early.phi[:2]).max() < 4.0 * ARCMIN
    assert np.abs(late.phi / late.sigma).max() < 4.0


def test_tilt_makes_no_difference() -> None:
    phi = []
    for tilt in (0.0, 2.0):
        data = drive("ring", 123.0, seed=2, ground_roll_deg=tilt, ground_pitch_deg=-tilt)
        phi.append(align(data, (5.0, 120.0)))
    (flat_early, flat), (tilted_early, tilted) = phi
    assert np.abs(tilted_early.phi[:2] - flat_early.phi[:2]).max() < 1.0 * ARCMIN
    assert abs(tilted.phi[2] - flat.phi[2]) < 0.5 * flat.sigma[2]


def test_unknown_lever_arm_mounting_and_latency() -> None:
    unknown = {
        "odometer_lever_arm_m": (1.2, -0.3, 0.5),
        "mounting_rpy_deg": (0.0, 0.3, 0.3),
        "odometer_latency_s": 0.1,
    }
    outcomes = [align(drive("ring", 123.0, s, **unknown), (120.0,))[0] for s in range(4)]
    assert rms([o.phi[2] for o in outcomes]) < 20.0 * ARCMIN
    assert_honest([heading_nees(o) for o in outcomes])


def _silent(t: float, epoch: AidedEpoch) -> AidedEpoch:
    return epoch._replace(travel=None) if 60.0 < t < 90.0 else epoch


def _scaled(travel: Travel, factor: float) -> Travel:
    return travel._replace(
        M=factor * travel.M,
        distance=factor * travel.distance,
        speed_start=factor * travel.speed_start,
        speed_end=factor * travel.speed_end,
    )


def _stuck(t: float, epoch: AidedEpoch) -> AidedEpoch:
    if epoch.travel is None or not 60.0 < t < 90.0:
        return epoch
    return epoch._replace(travel=_scaled(epoch.travel, 0.0))


def _slipping(t: float, epoch: AidedEpoch) -> AidedEpoch:
    if epoch.travel is None or t < 20.0 or t % 20.0 > 2.0:
        return epoch
    return epoch._replace(travel=_scaled(epoch.travel, 1.5))


def _wild(t: float, epoch: AidedEpoch) -> AidedEpoch:
    """One speed at the end of an epoch, far out."""
    if epoch.travel is None or not 80.0 < t < 81.5:
        return epoch
    return epoch._replace(travel=epoch.travel._replace(speed_end=-20.0))


@pytest.mark.parametrize("change", [_silent, _stuck, _slipping, _wild])
def test_odometer_that_fails_for_a_while(
    change: Callable[[float, AidedEpoch], AidedEpoch],
) -> None:
    for seed in range(3):
        data = drive("ring", 123.0, seed)
        clean = align(data, (120.0,))[0]
        outcome = align(data, (120.0,), change=change)[0]
        assert np.abs(outcome.phi / outcome.sigma).max() < 3.5
        assert abs(outcome.phi[2]) < 40.0 * ARCMIN
        assert outcome.sigma[2] > 0.95 * clean.sigma[2]


def test_heading_is_unobservable_at_the_pole() -> None:
    data = drive("static", 63.0, latitude_deg=89.9)
    outcome = align(data, (60.0,), aligner(latitude_deg=89.9))[0]
    assert outcome.sigma[2] > 30.0 * DEG
    assert np.abs(outcome.phi[:2]).max() < 4.0 * outcome.sigma[:2].max()


def test_nothing_before_there_is_something() -> None:
    under = aligner()
    for epoch in drive("static", 63.0).epochs[:2]:
        assert under.attitude is None
        under.add(epoch._replace(travel=None), standing=False)
    assert under.attitude is None


def test_start_attitude_is_that_of_the_start() -> None:
    data = drive("ring", 183.0, seed=3)
    under = aligner()
    align(data, (180.0,), under)
    found = under.attitude
    assert found is not None
    # The first epoch's rotation leads from its end, where the truth is known, to the start.
    early = found.C_n0b0 @ data.epochs[0].C_end
    assert np.abs(unskew(early @ data.C_nb[:, :, 0].T)[:2]).max() < 0.5 * ARCMIN


def test_rotation_from_a_quadratic_form() -> None:
    """A form with its minimum at a rotation, from any heading."""
    rng = np.random.default_rng(0)
    for _ in range(20):
        R = dcm_from_rpy(*rng.uniform(-np.pi, np.pi, 3))
        A = rng.standard_normal((12, 9))
        N = A.T @ A
        np.testing.assert_allclose(find_rotation(N, -N @ R.T.ravel()), R, atol=1e-7)


def test_variance_of_a_heading_that_nothing_tells() -> None:
    """Only up is known: all headings are as likely."""
    N = np.diag([0.0] * 6 + [1e6] * 3)
    R = dcm_from_rpy(0.1, 0.2, 0.3)
    n = -N @ R.T.ravel()
    assert heading_variance(R, N, n) == pytest.approx(np.pi**2 / 3.0, rel=0.01)
    np.testing.assert_allclose(find_rotation(N, n)[:, 2], R[:, 2], atol=1e-6)


def test_process_noise_composes() -> None:
    """Two short steps are one long one."""
    F, Q = transition(0.6, 1e-3, 1e-4)
    G, S = transition(1.2, 1e-3, 1e-4)
    np.testing.assert_allclose(F @ F, G, rtol=1e-12)
    np.testing.assert_allclose(F @ Q @ F.T + Q, S, rtol=1e-9, atol=1e-20)
