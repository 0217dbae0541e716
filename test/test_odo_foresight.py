"""The covariance of a drive foretold, against what the filter then finds."""

from __future__ import annotations

import functools
import math
import pickle
from dataclasses import replace
from functools import reduce
from itertools import pairwise

import numpy as np
import pytest
from odo_sessions import config_of, vehicle

from sins_align.limits import heading_limit
from sins_align.odo.aligner import OdoAligner
from sins_align.odo.foresight import (
    LEAST_MOTION_S,
    Stretch,
    _axes,
    _search,
    _stretch,
    _turned_axes,
)
from sins_align.odo.knowledge import knowledge_of
from sins_align.odo.layout import AZIMUTH, SIZE
from sins_align.odo.wander import WanderFilter
from sins_align.session import Session
from sins_align.simulate import VehicleRun
from sins_align.types import Array
from sins_align.units import ARCMIN

# An element of a covariance against the two sigma it belongs to.
TOLERANCE = 1e-7


def session_until(run: VehicleRun, time_s: float, **parameters: object) -> Session:
    """A drive's session, `time_s` after its start."""
    until_ns = run.options.start_stamp_ns + round(time_s * 1e9)
    session = Session(config_of(run, **parameters))
    session.add_odometer(run.odometer.select(run.odometer.stamp_ns <= until_ns))
    session.add_imu(run.imu.select(run.imu.stamp_ns <= until_ns))
    return session


def wander_of(session: Session) -> WanderFilter:
    aligner = session._aligner
    assert isinstance(aligner, OdoAligner) and aligner._wander is not None
    return aligner._wander


@functools.cache
def aligned_at(scenario: str, threshold_arcmin: float) -> float:
    """When aligned was claimed, with no time to hold [s]."""
    session = session_until(
        vehicle(scenario, 300.0),
        300.0,
        heading_threshold_arcmin=threshold_arcmin,
        level_threshold_arcsec=600.0,
        hold_s=0.0,
    )
    at_s = session.status.aligned_at_s
    assert at_s is not None
    return at_s


def assert_close(P: Array, expected: Array) -> None:
    """Both in units of their sigma."""
    sigma = np.sqrt(expected.diagonal())
    known = sigma > 0.0  # the gauge and a state that is not used have none
    scale = np.outer(sigma[known], sigma[known])
    off = np.abs(P - expected)[np.ix_(known, known)] / scale
    assert off.max() < TOLERANCE


def random_stretch(seed: int) -> Stretch:
    stream = np.random.default_rng(seed)
    F = np.eye(SIZE) + 0.1 * stream.standard_normal((SIZE, SIZE))
    W, G = (B @ B.T / SIZE for B in stream.standard_normal((2, SIZE, SIZE)))
    return Stretch(F, W, G, 1.0 + seed)


# -- the star product


def test_two_stretches_in_a_row() -> None:
    first, second = random_stretch(1), random_stretch(2)
    P = random_stretch(3).W
    assert_close(first.then(second).carry(P), second.carry(first.carry(P)))
    assert first.then(second).duration_s == 5.0


def test_doubled_is_repeated() -> None:
    stretch, P = random_stretch(1), random_stretch(3).W
    doubled = reduce(lambda s, _: s.then(s), range(5), stretch)
    repeated = reduce(lambda Q, _: stretch.carry(Q), range(32), P)
    assert doubled.duration_s == 64.0
    assert_close(doubled.carry(P), repeated)


@pytest.mark.parametrize("scenario", ["static", "ring", "urban"])
@pytest.mark.parametrize("at_s", [30.0, 150.0])
def test_the_star_product_of_a_drive_is_what_the_filter_did(scenario: str, at_s: float) -> None:
    """With two azimuth states at 30 s, and with one at 150 s; nothing went wrong meanwhile."""
    run = vehicle(scenario, 300.0)
    session = session_until(run, at_s)
    filter_ = wander_of(session)
    one_azimuth, start, stretches = filter_.one_azimuth, filter_.P.copy(), []
    process = filter_.process

    def watched(*arguments: object) -> bool:
        stands = process(*arguments)  # type: ignore[arg-type]
        axes = _axes(filter_.navigation.e_a) if one_azimuth else None
        assert filter_.step is not None
        stretches.append((_stretch(filter_.step, axes), axes, filter_.P.copy()))
        return stands

    filter_.process = watched  # type: ignore[method-assign]
    axes_at_start = _axes(filter_.navigation.e_a)
    begin_ns, end_ns = (run.options.start_stamp_ns + round(t * 1e9) for t in (at_s, at_s + 8.0))
    for samples, add in ((run.odometer, session.add_odometer), (run.imu, session.add_imu)):
        add(samples.select((samples.stamp_ns > begin_ns) & (samples.stamp_ns <= end_ns)))
    assert filter_.one_azimuth == one_azimuth
    T, T_end = np.eye(SIZE), np.eye(SIZE)
    if one_azimuth:
        T[AZIMUTH, AZIMUTH], T_end[AZIMUTH, AZIMUTH] = axes_at_start, stretches[-1][1]
    assert len(stretches) >= 3
    found = reduce(Stretch.then, (s for s, _, _ in stretches)).carry(T @ start @ T.T)
    expected = T_end @ stretches[-1][2] @ T_end.T
    # The axes of one azimuth turn with the estimate, which is corrected meanwhile.
    sigma = np.sqrt(np.maximum(expected.diagonal(), 1e-30))
    assert np.abs(np.sqrt(np.maximum(found.diagonal(), 1e-30)) / sigma - 1.0).max() < 1e-2


@pytest.mark.parametrize("at", [5, 40, 100])
def test_the_time_is_that_of_repeated_stretches(at: int) -> None:
    """Two seconds of a real drive, over and over in axes that turn by 20 deg each time."""
    session = session_until(vehicle("ring", 300.0), 60.0)
    aligner, filter_ = session._aligner, wander_of(session)
    assert isinstance(aligner, OdoAligner)
    stretches = [_stretch(step, axes) for step, axes, _ in aligner._foresight._steps][-2:]
    turn = math.radians(20.0)
    variances, P, time_s = [], filter_.P, []
    for _ in range(120):
        D = _turned_axes(turn)
        P = D @ P @ D.T
        for stretch in stretches:
            P = stretch.carry(P)
            variances.append(float(P[AZIMUTH, AZIMUTH].trace()))
            time_s.append((time_s[-1] if time_s else 0.0) + stretch.duration_s)
    assert np.all(np.diff(variances) < 0.0)
    asked = []

    def is_reached(P: Array, turned: float) -> bool:
        asked.append(turned / turn)
        return bool(P[AZIMUTH, AZIMUTH].trace() <= variances[at] * (1.0 + 1e-9))

    assert _search(filter_.P, stretches, turn, is_reached) == pytest.approx(time_s[at])
    # Within the repetition that is sought, the axes have turned once more.
    assert asked[-1] == pytest.approx(at // 2 + 1)
    assert _search(filter_.P, stretches, turn, lambda *_: False) == math.inf


# -- through the session


@pytest.mark.parametrize(
    ("scenario", "threshold"),
    [("static", 8.0), ("ring", 8.0), ("figure8", 8.0), ("straight", 10.0)],
)
def test_what_is_foretold_comes_true(scenario: str, threshold: float) -> None:
    """Aligned within 30 % of what was said at 60 s, where the motion goes on as it was."""
    session = session_until(
        vehicle(scenario, 300.0),
        60.0,
        heading_threshold_arcmin=threshold,
        level_threshold_arcsec=600.0,
        hold_s=0.0,
    )
    left_s = aligned_at(scenario, threshold) - 60.0
    assert left_s > 10.0
    assert session.eta_s == pytest.approx(left_s, rel=0.3)


def told_and_true(run: VehicleRun, threshold: float) -> tuple[float, float | None]:
    """Time to go as said at 60 s, and as it came within 300 s."""
    settings = {
        "heading_threshold_arcmin": threshold, "level_threshold_arcsec": 600.0, "hold_s": 0.0,
    }  # fmt: skip
    early, whole = (session_until(run, time_s, **settings) for time_s in (60.0, 300.0))
    at_s = whole.status.aligned_at_s
    return early.eta_s, None if at_s is None else at_s - 60.0


def test_samples_go_on_to_be_lost() -> None:
    """1 % of them cost a laser gyro on the road heading, again and again."""
    run = vehicle("ring", 300.0, grade="rlg", lost_fraction=0.01)
    told_s, true_s = told_and_true(run, 22.0)
    assert true_s is not None and told_s == pytest.approx(true_s, rel=0.3)
    told_s, true_s = told_and_true(run, 5.0)
    assert true_s is None and told_s > 900.0


def test_a_gap_that_came_once_is_not_foreseen_again() -> None:
    run = vehicle("ring", 300.0, grade="rlg")
    time_s = (run.imu.stamp_ns - run.options.start_stamp_ns) * 1e-9
    cut = run.imu.select((time_s < 40.0) | (time_s > 40.3))
    told_s, true_s = told_and_true(replace(run, imu=cut), 6.0)
    assert true_s is not None and told_s == pytest.approx(true_s, rel=0.3)


def test_each_epoch_keeps_its_own_transition() -> None:
    """The model fills the same array again and again."""
    aligner = session_until(vehicle("ring", 300.0), 60.0)._aligner
    assert isinstance(aligner, OdoAligner)
    steps = [step for step, _, _ in aligner._foresight._steps]
    assert not any(np.array_equal(a.A, b.A) for a, b in pairwise(steps))


def test_nothing_is_said_early() -> None:
    run = vehicle("static", 300.0)
    early, late = (
        session_until(run, k * LEAST_MOTION_S, heading_threshold_arcmin=12.0) for k in (0.5, 2.0)
    )
    assert math.isnan(early.eta_s) and 0.0 < late.eta_s < 600.0


def test_never_below_the_limit_of_standing() -> None:
    run = vehicle("static", 300.0)
    limit = heading_limit(run.options.imu_grade, math.radians(run.options.latitude_deg)) / ARCMIN
    never = session_until(run, 60.0, heading_threshold_arcmin=0.8 * limit)
    assert never.eta_s == math.inf
    assert session_until(run, 60.0, heading_threshold_arcmin=1.5 * limit).eta_s < 900.0


def test_asking_changes_nothing() -> None:
    run = vehicle("ring", 300.0)
    asked, silent = (session_until(run, 60.0) for _ in range(2))
    before = pickle.dumps(asked)
    first = asked.eta_s
    assert math.isfinite(first) and asked.eta_s == first
    assert pickle.dumps(asked) == before
    begin_ns = run.options.start_stamp_ns + round(60e9)
    for session in (asked, silent):
        session.add_odometer(run.odometer.select(run.odometer.stamp_ns > begin_ns))
        session.add_imu(run.imu.select(run.imu.stamp_ns > begin_ns))
    a, b = asked.estimate, silent.estimate
    assert a is not None and b is not None
    assert np.array_equal(a.q_nb, b.q_nb)
    assert np.array_equal(a.misalignment_covariance, b.misalignment_covariance)


def test_now_is_what_the_filter_knows() -> None:
    """A threshold just above sigma is reached at once, one just below it is not."""
    session = session_until(vehicle("ring", 300.0), 120.0)
    aligner, filter_ = session._aligner, wander_of(session)
    assert isinstance(aligner, OdoAligner)
    sigma = math.sqrt(knowledge_of(filter_).covariance[2, 2])
    soon = aligner._foresight.time_until(filter_, 0.99 * sigma)
    later = aligner._foresight.time_until(filter_, 0.5 * sigma)
    assert soon < 10.0 < later
