"""The covariance propagated ahead against what it then really is."""

from __future__ import annotations

import functools
import math
from dataclasses import replace

import numpy as np
import pytest
from swing_filtered import EPOCH_S, OPTIONS, Filtered, filter_run

from sins_align.config import swing_config
from sins_align.earth import earth_rate_n
from sins_align.limits import heading_limit
from sins_align.session import Session
from sins_align.simulate import simulate_swing
from sins_align.swing.foresight import time_to
from sins_align.swing.two_stage import build_steps
from sins_align.swing.two_stage_filter import TwoStageFilter
from sins_align.types import Array

SCENARIOS = pytest.mark.parametrize("scenario", ["still", "level", "pitch", "erect"])


@functools.cache
def run(scenario: str, duration_s: float, grade: str = "rlg") -> Filtered:
    options = replace(OPTIONS, scenario=scenario, duration_s=duration_s, grade=grade, seed=5)
    return filter_run(options)


def earth_rate_b0(filtered: Filtered) -> Array:
    return filtered.truth.R @ earth_rate_n(filtered.gravity.latitude)


def foresee(filtered: Filtered, threshold: float) -> float:
    return time_to(
        threshold,
        filtered.filter,
        filtered.epochs,
        filtered.truth,
        filtered.gravity,
        filtered.noise,
        filtered.heading_sigma,
    )


# -- epochs that go on


def test_the_past_is_kept() -> None:
    filtered = run("pitch", 60.0)
    epochs = filtered.epochs
    future = epochs.continued(40, earth_rate_b0(filtered))
    assert len(future) == len(epochs) + 40 and len(epochs) == 120
    for name in ("duration_s", "time_s", "C", "u", "s", "B", "BB"):
        old = getattr(epochs, name)
        assert np.array_equal(getattr(future, name)[: old.shape[0]], old)
    assert np.array_equal(future.q, epochs.q)
    assert np.diff(future.time_s) == pytest.approx(future.duration_s)


def test_a_still_base_turns_with_the_earth() -> None:
    """Five minutes foretold from one, against the five minutes themselves."""
    options = replace(OPTIONS, scenario="still", grade="perfect", rate_hz=20.0, seed=1)
    noisy = replace(OPTIONS.imu_grade)
    past = filter_run(options, declared=noisy)
    whole = filter_run(replace(options, duration_s=300.0), declared=noisy).epochs
    future = past.epochs.continued(480, earth_rate_b0(past))
    assert len(future) == len(whole) == 600
    assert future.time_s == pytest.approx(whole.time_s)
    for name in ("C", "u", "s", "B", "BB"):
        error = np.abs(getattr(future, name) - getattr(whole, name)).max()
        # The Earth turns by 0.02 rad meanwhile.
        assert error < 2e-6 * np.abs(getattr(whole, name)).max(), name


@SCENARIOS
def test_the_motion_goes_on_without_a_jump(scenario: str) -> None:
    filtered = run(scenario, 60.0)
    epochs = filtered.epochs
    future = epochs.continued(200, earth_rate_b0(filtered))
    turn = np.abs(np.diff(future.C, axis=0)).max(axis=(1, 2))
    usual = turn[: len(epochs)].max()
    assert turn[len(epochs) :].max() < 1.5 * usual + 1e-4
    C = future.C[len(epochs) :]
    assert np.abs(C @ C.transpose(0, 2, 1) - np.eye(3)).max() < 1e-12
    # Gravity stays where it is: mean force of a minute.
    mean = future.u[len(epochs) :].sum(axis=0) / future.duration_s[len(epochs) :].sum()
    before = epochs.u.sum(axis=0) / epochs.duration_s.sum()
    assert np.abs(mean - before).max() < 0.02 * np.linalg.norm(before)


# -- sigma ahead


@SCENARIOS
@pytest.mark.parametrize("grade", ["rlg", "tactical"])
def test_sigma_ahead_is_what_it_then_is(scenario: str, grade: str) -> None:
    now, then = run(scenario, 60.0, grade), run(scenario, 240.0, grade)
    future = now.epochs.continued(round(180.0 / EPOCH_S), earth_rate_b0(now))
    ahead = now.filter.copy()
    ahead.run(build_steps(future, len(now.epochs), now.truth, now.gravity, now.noise), None)
    predicted, real = now.heading_sigma(ahead), then.heading_sigma(then.filter)
    assert predicted == pytest.approx(real, rel=0.15)
    if grade == "rlg":
        assert real < 0.4 * now.heading_sigma(now.filter)


@SCENARIOS
def test_the_time_is_that_of_the_sigma(scenario: str) -> None:
    now, then = run(scenario, 60.0), run(scenario, 150.0)
    ahead_s = foresee(now, then.heading_sigma(then.filter))
    assert 60.0 + ahead_s == pytest.approx(150.0, rel=0.1)


def test_never_below_the_limit() -> None:
    filtered = run("still", 60.0, "tactical")
    grade = filtered.run.options.imu_grade
    limit = heading_limit(grade, filtered.gravity.latitude)
    assert foresee(filtered, 0.9 * limit) == math.inf
    assert foresee(filtered, 1.1 * limit) < 3600.0


def test_the_filter_is_not_changed() -> None:
    filtered = run("pitch", 60.0)
    before = filtered.filter.copy()
    foresee(filtered, 1e-4)
    after = filtered.filter
    for a, b in ((before.X, after.X), (before.P, after.P), (before.normal, after.normal)):
        assert np.array_equal(a, b)
    assert before.noise == after.noise or before.noise.variance == after.noise.variance
    assert isinstance(before, TwoStageFilter) and len(filtered.epochs) == 120


# -- through the session


def session_at(duration_s: float, scenario: str = "pitch", **parameters: object) -> Session:
    options = replace(OPTIONS, scenario=scenario, duration_s=duration_s, seed=5)
    values = {"latitude_deg": 40.0, "altitude_m": 50.0, "imu_grade": "rlg", "hold_s": 0.0}
    session = Session(swing_config({**values, **parameters}))
    session.add_imu(simulate_swing(options).imu)
    return session


def test_nothing_to_wait_for_where_sigma_is_below() -> None:
    """Of heading; of the levels, which may still be missing, nothing is foretold."""
    settings = {"level_threshold_arcsec": 1e-3, "heading_threshold_arcmin": 60.0}
    session = session_at(60.0, **settings)
    assert session.status.keys == ("level_sigma", "level_limit")
    assert session._aligner is not None
    assert session._aligner.foresee(math.radians(1.0)) == 0.0 and math.isnan(session.eta_s)


def test_the_limit_is_never_reached() -> None:
    limit = heading_limit(OPTIONS.imu_grade, math.radians(40.0)) / math.radians(1.0 / 60.0)
    assert session_at(60.0, "still", heading_threshold_arcmin=0.9 * limit).eta_s == math.inf
    assert session_at(60.0, "still", heading_threshold_arcmin=1.3 * limit).eta_s < 600.0


@pytest.mark.parametrize("scenario", ["still", "pitch"])
def test_what_is_foretold_comes_true(scenario: str) -> None:
    """Aligned within 30 % of what was said at 40 s."""
    eta_s = session_at(40.0, scenario, heading_threshold_arcmin=2.0).eta_s
    aligned_at_s = session_at(240.0, scenario, heading_threshold_arcmin=2.0).status.aligned_at_s
    assert aligned_at_s is not None
    assert eta_s > 20.0
    assert eta_s == pytest.approx(aligned_at_s - 40.0, rel=0.3)
