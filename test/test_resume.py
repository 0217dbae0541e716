"""Going on from a stored alignment: what is believed, what is refused, how honest sigma stays.

Every case is a pair of runs: the first one aligns and leaves its result document, the second
one, with other noise, starts from it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from resumed_runs import (
    FIRST,
    SECOND,
    STILL,
    estimates_after_check,
    first_run,
    resume,
    rlg_run,
    second_run,
    still,
)
from scipy.stats import chi2

from evidence.monte_carlo import make_config, misalignment_of
from sins_align.resume import AGREEMENT_LIMIT
from sins_align.session import Session
from sins_align.simulate import SwingOptions, SwingRun, simulate_swing
from sins_align.stored import StoredAlignment
from sins_align.stored_check import CHECK_S, CHI_SQUARE_LIMIT, DEGREES
from sins_align.types import Array, ImuSamples, State
from sins_align.units import ARCMIN

PAIRS = 30


def with_biases_of(run: SwingRun, other: SwingRun) -> ImuSamples:
    """The samples of `run` as the sensors of `other` would have given them."""
    gyro = other.truth.gyro_bias_rad_s - run.truth.gyro_bias_rad_s
    accel = other.truth.accel_bias_m_s2 - run.truth.accel_bias_m_s2
    imu = run.imu
    return ImuSamples(imu.stamp_ns, imu.w_ib_b + gyro[:, None], imu.f_ib_b + accel[:, None])


@dataclass(frozen=True)
class Pair:
    """The second run's estimate at its end, which the first one's attitude is carried to."""

    phi: Array
    covariance: Array
    stored: StoredAlignment
    consistency: float
    is_resumed: bool


def run_pair(options: SwingOptions, seed: int, *, same_sensors: bool) -> Pair:
    first, stored = first_run(replace(options, seed=seed))
    second = simulate_swing(replace(options, seed=seed + 1000, duration_s=45.0))
    imu = with_biases_of(second, first) if same_sensors else second.imu
    session, _ = resume(make_config(second, FIRST), stored, imu)
    estimate = session.estimate
    assert estimate is not None
    return Pair(
        misalignment_of(estimate, second.truth.C_nb_at(estimate.stamp_ns)),
        estimate.misalignment_covariance,
        stored,
        estimate.consistency,
        estimate.misalignment_covariance[2, 2] < 1.01 * stored.misalignment_covariance[2, 2],
    )


@pytest.mark.parametrize("same_sensors", [True, False])
@pytest.mark.parametrize("grade", ["rlg", "tactical"])
def test_a_base_in_place_is_accepted_and_sigma_honest(grade: str, same_sensors: bool) -> None:
    options = replace(STILL, grade=grade)
    pairs = [run_pair(options, seed, same_sensors=same_sensors) for seed in range(PAIRS)]
    assert all(pair.is_resumed for pair in pairs)
    nees = [p.phi @ np.linalg.solve(p.covariance, p.phi) for p in pairs]
    low, high = chi2.ppf([0.0005, 0.9995], 3 * PAIRS) / PAIRS
    assert low < np.mean(nees) < high
    heading = [p.phi[2] ** 2 / p.covariance[2, 2] for p in pairs]
    low, high = chi2.ppf([0.0005, 0.9995], PAIRS) / PAIRS
    assert low < np.mean(heading) < high
    # The check itself: with other biases as many as declared, with the same ones fewer.
    square = np.array([pair.consistency for pair in pairs]) * CHI_SQUARE_LIMIT
    low, high = chi2.ppf([0.0005, 0.9995], DEGREES * PAIRS) / PAIRS
    assert square.mean() < high
    assert same_sensors or square.mean() > low


def test_limits_are_the_quantiles_that_they_claim() -> None:
    assert chi2.sf(CHI_SQUARE_LIMIT, DEGREES) == pytest.approx(1e-4, rel=0.01)
    assert chi2.sf(AGREEMENT_LIMIT, 3) == pytest.approx(1e-5, rel=0.01)


def test_heading_is_no_better_than_before() -> None:
    """Two alignments with one bias are no better than one: no sigma / sqrt(2)."""
    pair = run_pair(replace(STILL, grade="rlg"), 3, same_sensors=True)
    assert pair.covariance[2, 2] > 0.999 * pair.stored.misalignment_covariance[2, 2]


@pytest.fixture(scope="module")
def rlg() -> tuple[SwingRun, StoredAlignment]:
    return rlg_run()


def test_aligned_in_no_time(rlg: tuple[SwingRun, StoredAlignment]) -> None:
    run = second_run()
    parameters = {"heading_threshold_arcmin": 1.5, "hold_s": 5.0}
    session, updates = resume(make_config(run, parameters), rlg[1], run.imu)
    assert session.status.state is State.ALIGNED
    assert session.status.aligned_at_s == pytest.approx(CHECK_S + 5.0, abs=1.5)
    fresh = Session(make_config(run, parameters))
    fresh.add_imu(run.imu)
    assert fresh.status.state is not State.ALIGNED
    checking = [u.status.reason for u in updates if u.stamp_ns < run.imu.stamp_ns[0] + 25 * SECOND]
    assert all("checking the stored alignment" in reason for reason in checking)
    assert "of 30 s)" in checking[-1]


@pytest.mark.parametrize("at_s", [5.0, 10.0, 29.0, 31.0])
def test_the_time_to_go_is_that_of_the_stored_one(
    rlg: tuple[SwingRun, StoredAlignment], at_s: float
) -> None:
    """Which aligned_at_s then is, within the second of a block."""
    run = second_run()
    parameters = {"heading_threshold_arcmin": 1.5, "hold_s": 5.0}
    session, _ = resume(
        make_config(run, parameters), rlg[1], run.imu.select(slice(0, round(50 * at_s)))
    )
    eta_s = session.eta_s
    session.add_imu(run.imu.select(slice(round(50 * at_s), None)))
    assert session.status.aligned_at_s == pytest.approx(at_s + eta_s, abs=1.5)


def test_a_stored_one_above_the_threshold_shortens_nothing(
    rlg: tuple[SwingRun, StoredAlignment],
) -> None:
    run = second_run()
    parameters = {"heading_threshold_arcmin": 1.0, "hold_s": 5.0}  # 1.08 are stored
    begin = run.imu.select(slice(0, 50 * 20))
    session, _ = resume(make_config(run, parameters), rlg[1], begin)
    fresh = Session(make_config(run, parameters))
    fresh.add_imu(begin)
    assert math.inf > session.eta_s == fresh.eta_s > 100.0


def test_nothing_of_it_is_given_out_before_the_check_is_done(
    rlg: tuple[SwingRun, StoredAlignment],
) -> None:
    run = second_run()
    fresh = Session(make_config(run, FIRST))
    begin = run.imu.select(slice(0, 50 * 29))
    _, updates = resume(make_config(run, FIRST), rlg[1], begin)
    for mine, other in zip(updates, fresh.add_imu(begin), strict=True):
        assert (mine.estimate is None) == (other.estimate is None)
        if mine.estimate is not None and other.estimate is not None:
            assert (mine.estimate.q_nb == other.estimate.q_nb).all()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"heading_deg": 31.0}, "the Earth's rate differs"),
        ({"heading_deg": 210.0}, "the Earth's rate differs"),
        ({"scenario": still(tilt_deg=0.1)}, "gravity differs by 6.1'"),
        ({"scenario": still(swing_deg=0.2)}, "the base moves too much"),
        ({"turn_deg": 90.0, "turn_start_s": 5.0}, "the base moves too much"),
        ({"turn_deg": 9.0, "turn_start_s": 0.0, "turn_duration_s": 59.0}, "stored alignment"),
    ],
)
def test_a_base_that_has_moved_is_refused(
    changes: dict[str, Any], words: str, rlg: tuple[SwingRun, StoredAlignment]
) -> None:
    """And the alignment goes on as if nothing had been stored, but says why."""
    run = second_run(**changes)
    config = make_config(run, {"heading_threshold_arcmin": 0.1})
    session, _ = resume(config, rlg[1], run.imu)
    assert words in session.status.reason
    assert "clear initial_result_file" in session.status.remedy
    fresh = Session(config)
    fresh.add_imu(run.imu)
    mine, other = session.conclusion, fresh.conclusion
    assert mine is not None and other is not None
    assert (mine.q_nb == other.q_nb).all()
    assert (mine.misalignment_covariance == other.misalignment_covariance).all()


def test_a_turn_too_small_for_the_check_is_found_when_it_can_be(
    rlg: tuple[SwingRun, StoredAlignment],
) -> None:
    """10' are eight sigma of the stored heading, but four of the Earth's rate in 30 s."""
    run = simulate_swing(
        replace(STILL, grade="rlg", seed=1005, duration_s=300.0, heading_deg=30.0 + 10.0 / 60.0)
    )
    session, updates = resume(make_config(run, {"heading_threshold_arcmin": 0.1}), rlg[1], run.imu)
    given = estimates_after_check(updates, int(run.imu.stamp_ns[0]))
    assert given[0].misalignment_covariance[2, 2] < (2.0 * ARCMIN) ** 2  # believed at first
    assert "the new one differs by" in session.status.reason
    estimate = session.conclusion
    assert estimate is not None
    phi = misalignment_of(estimate, run.truth.C_nb_at(estimate.stamp_ns))
    assert abs(phi[2]) < 4.0 * estimate.sigma[2]


def test_the_new_alignment_takes_over_for_good_when_it_is_better() -> None:
    """A first run of 60 s of a gyro with more noise than bias: 120 s know better."""
    first, stored = first_run(replace(STILL, grade="rlg", seed=8, duration_s=60.0))
    run = simulate_swing(replace(STILL, grade="rlg", seed=1008, duration_s=200.0))
    session, updates = resume(make_config(run, FIRST), stored, with_biases_of(run, first))
    given = estimates_after_check(updates, int(run.imu.stamp_ns[0]))
    sigma = np.array([estimate.sigma[2] for estimate in given])
    assert sigma[-1] < 0.8 * math.sqrt(stored.misalignment_covariance[2, 2])
    assert (np.diff(sigma) <= 1e-3 * sigma[:-1]).all()  # never back to the stored one
    fresh = Session(make_config(run, FIRST))
    fresh.add_imu(with_biases_of(run, first))
    mine, other = session.conclusion, fresh.conclusion
    assert mine is not None and other is not None
    assert (mine.q_nb == other.q_nb).all()


def test_how_samples_come_changes_nothing(rlg: tuple[SwingRun, StoredAlignment]) -> None:
    run = second_run()
    whole, _ = resume(make_config(run, {}), rlg[1], run.imu)
    pieces = Session(replace(make_config(run, {}), initial=rlg[1]))
    for chunk in run.chunks(0.37):
        pieces.add_imu(chunk)
        assert pieces.estimate is None or np.isfinite(pieces.estimate.q_nb).all()
    a, b = whole.estimate, pieces.estimate
    assert a is not None and b is not None
    assert (a.q_nb == b.q_nb).all()
    assert (a.misalignment_covariance == b.misalignment_covariance).all()
    assert a.stamp_ns == run.imu.stamp_ns[-1]


def test_the_method_of_the_paper_resumes_too(rlg: tuple[SwingRun, StoredAlignment]) -> None:
    run = second_run()
    session, _ = resume(make_config(run, {"method": "paper"}), rlg[1], run.imu)
    estimate = session.conclusion
    assert estimate is not None
    assert estimate.sigma[2] < 2.0 * ARCMIN
