"""What drops a stored alignment, and what is too much in doubt to do so."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from resumed_runs import STILL, WIND, known, resume, rlg_run, second_run

from evidence.monte_carlo import make_config, misalignment_of
from sins_align.intake import Intake
from sins_align.reasons import GYRO_NOISY, LATITUDE_DOUBTED, STORED_DROPPED, Finding
from sins_align.resume import ResumingAligner
from sins_align.rotation import exp_rotation, quaternion_from_dcm
from sins_align.simulate import SwingRun, simulate_swing
from sins_align.stored import StoredAlignment
from sins_align.types import (
    Advance,
    Array,
    Estimate,
    ImuBlock,
    ImuSamples,
    InputCounts,
    State,
    Update,
)
from sins_align.units import ARCMIN, ARCSEC, DEG


def said(updates: list[Update]) -> list[str]:
    """What is said of the dropped alignment, by update."""
    return [
        "; ".join(f.text for f in u.status.findings if f.reason is STORED_DROPPED) for u in updates
    ]


def assert_said_until_there_is_an_estimate(updates: list[Update], why: str) -> None:
    first = next(k for k, u in enumerate(updates) if u.estimate is not None)
    assert first > 0
    words = f"the stored alignment is dropped: the alignment began anew: {why}"
    assert said(updates[:first]) == [words] * first
    assert set(said(updates[first:])) == {""}


@pytest.fixture(scope="module")
def rlg() -> tuple[SwingRun, StoredAlignment]:
    return rlg_run()


def test_a_restart_drops_it(rlg: tuple[SwingRun, StoredAlignment]) -> None:
    """Nobody has seen whether the base has moved meanwhile."""
    run = second_run()
    session, _ = resume(make_config(run, {}), rlg[1], run.imu.select(slice(0, 50 * 20)))
    session.restart()
    assert session.status.keys == ("no_imu", "began_anew", "stored_dropped")
    updates = session.add_imu(run.imu.select(slice(50 * 20, None)))
    assert_said_until_there_is_an_estimate(updates, "restarted on request")
    estimate = session.estimate
    assert estimate is not None
    assert estimate.sigma[2] > 2.0 * ARCMIN
    session.restart()  # there is nothing left to drop
    assert "stored_dropped" not in session.status.keys


@pytest.mark.parametrize("at_s", [10, 40])
def test_a_gap_drops_it(at_s: int, rlg: tuple[SwingRun, StoredAlignment]) -> None:
    run = second_run()
    gap = run.imu.select(np.r_[0 : 50 * at_s, 50 * (at_s + 2) : len(run.imu)])
    session, updates = resume(make_config(run, {}), rlg[1], gap)
    assert session.restarts == 1
    later = [u for u in updates if u.stamp_ns > run.imu.stamp_ns[50 * at_s]]
    assert_said_until_there_is_an_estimate(later, "2.0 s without IMU data")


def test_a_fault_drops_it(rlg: tuple[SwingRun, StoredAlignment]) -> None:
    run = second_run()
    f = run.imu.f_ib_b.copy()
    f[:, 50 * 20 : 50 * 21] = 0.0
    imu = ImuSamples(run.imu.stamp_ns, run.imu.w_ib_b, f)
    _, updates = resume(make_config(run, {}), rlg[1], imu)
    failed = next(k for k, u in enumerate(updates) if u.status.state is State.FAILED)
    fault = updates[failed].status.findings[0].text
    assert_said_until_there_is_an_estimate(updates[failed:], fault)


def test_gyros_that_become_noisy_are_doubted_while_the_stored_one_is_given_out() -> None:
    """It is the gyros that carry it; what is known of them does not wait for the new one."""
    run = simulate_swing(replace(STILL, grade="rlg", duration_s=240.0))
    attitude = quaternion_from_dcm(run.truth.C_nb_at(int(run.imu.stamp_ns[0])))
    sigma = np.array([20.0 * ARCSEC, 20.0 * ARCSEC, 0.8 * ARCMIN])
    stored = StoredAlignment(attitude, np.diag(sigma**2))
    config = make_config(run, {"imu_grade": "rlg"})
    # Eight times the declared noise, from a minute on.
    white = np.random.default_rng(1).standard_normal(run.imu.w_ib_b.shape)
    white[:, : 60 * 50] = 0.0
    w = run.imu.w_ib_b + 8.0 * config.grade.gyro_arw * math.sqrt(50.0) * white
    imu = ImuSamples(run.imu.stamp_ns, w, run.imu.f_ib_b)
    _, updates = resume(config, stored, imu)
    early = [u for u in updates if 45.0 < u.status.elapsed_s < 60.0]
    assert {u.status.state for u in early} == {State.ALIGNED}
    noisy = [u for u in updates if "gyro_noisy" in u.status.keys]
    assert State.ALIGNED not in {u.status.state for u in noisy}
    assert noisy[0].status.keys == ("gyro_noisy",) and noisy[0].estimate is not None
    assert noisy[0].estimate.sigma[2] < 0.85 * ARCMIN  # the stored one's
    assert updates[-1] is noisy[-1]


@pytest.mark.parametrize("seed", [2, 5, 7])
def test_a_new_one_in_doubt_does_not_drop_it(seed: int) -> None:
    """Gyros at ten times the declared noise from a minute on: the new one is off by six sigma."""
    run = simulate_swing(replace(STILL, grade="rlg", duration_s=210.0, seed=seed))
    config = make_config(run, {"imu_grade": "rlg"})
    white = np.random.default_rng(seed).standard_normal(run.imu.w_ib_b.shape)
    white[:, : 60 * 50] = 0.0
    w = run.imu.w_ib_b + 10.0 * config.grade.gyro_arw * math.sqrt(50.0) * white
    imu = ImuSamples(run.imu.stamp_ns, w, run.imu.f_ib_b)
    session, updates = resume(config, known(run, 0.8 * ARCMIN), imu)
    assert set(said(updates)) == {""}
    estimate = session.conclusion
    assert estimate is not None and estimate.sigma[2] < 0.85 * ARCMIN
    phi = misalignment_of(estimate, run.truth.C_nb_at(estimate.stamp_ns))
    assert abs(phi[2]) < 3.0 * estimate.sigma[2]  # the levels drift off, by gyros that are worse
    assert session.status.state is not State.ALIGNED


class Told:
    """An aligner that says the same at every block."""

    def __init__(self, run: SwingRun, phi: Array, sigma: float, *said: Finding, **changes: Any):
        C_nb = exp_rotation(-phi) @ run.truth.C_nb_at(int(run.imu.stamp_ns[0]))
        P, zero = np.diag([ARCMIN**2 * 100.0, ARCMIN**2 * 100.0, sigma**2]), np.zeros(3)
        rest = {"consistency": 1.0, **changes}
        self.estimate = Estimate(0, quaternion_from_dcm(C_nb), P, zero, zero, zero, zero, **rest)
        self.said = said

    def update(self, block: ImuBlock) -> list[Advance]:
        return [Advance(int(block.stamp_ns[-1]), self.estimate, self.said)]


DOUBTED: dict[str, tuple[tuple[Finding, ...], dict[str, Any]]] = {
    "a doubt": ((GYRO_NOISY(factor=4.0, log_ratio=9.0),), {}),
    "the latitude": ((LATITUDE_DOUBTED(ratio=4.0, sigma_deg=0.1),), {}),
    "inconsistent": ((), {"consistency": 3.0}),
    "no innovation yet": ((), {"consistency": math.nan}),
    "not finite": ((), {"q_nb": np.full(4, math.nan)}),
}


@pytest.mark.parametrize("case", ["", *DOUBTED])
def test_what_is_in_doubt_says_nothing(case: str) -> None:
    """Of a heading that waits to be confirmed: unless it is in doubt, one confirms, one drops."""
    run = second_run(**WIND)
    shaken = np.random.default_rng(1).normal(0.0, 0.02, run.imu.f_ib_b.shape)
    config, stored = make_config(run, {}), known(run, 2.0 * ARCMIN)
    assert config.position is not None
    findings, changes = DOUBTED.get(case, ((), {}))
    for turned, sigma in ((0.0, 0.2 * DEG), (10.0 * DEG, 0.2 * DEG), (0.0, 0.1 * ARCMIN)):
        told = Told(run, np.array([0.0, 0.0, turned]), sigma, *findings)
        told.estimate = replace(told.estimate, **changes)
        aligner = ResumingAligner(told, config, config.position, stored)  # type: ignore[arg-type]
        intake = Intake(InputCounts())
        intake.add(ImuSamples(run.imu.stamp_ns, run.imu.w_ib_b, run.imu.f_ib_b + shaken))
        steps: list[Advance] = []
        while (block := intake.next_block()) is not None:
            steps += aligner.update(block)
        keys = [f.reason.key for f in steps[-1].findings if f not in findings]
        if case:
            assert keys == ["stored_confirm"]
            continue
        assert keys == (["stored_dropped"] if turned else [])
        is_stored = steps[-1].estimate is not told.estimate
        assert is_stored == (turned == 0.0 and sigma > ARCMIN)
