"""Gyros in degrees, and axes that differ: noticed within a minute, and never where all is right."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest
from odo_sessions import align, vehicle

from sins_align.config import swing_config
from sins_align.session import Session
from sins_align.simulate import SCENARIOS, SwingOptions, simulate_swing
from sins_align.types import Array, ImuBlock, ImuSamples, ImuSampling, State, Update
from sins_align.units import DEG
from sins_align.units_watch import VERDICTS, UnitsWatch

SECOND = 1_000_000_000
OPTIONS = SwingOptions(
    grade="rlg", duration_s=100.0, rate_hz=50.0, seed=2, latitude_deg=40.0, altitude_m=50.0
)


@functools.cache
def imu(scenario: str, seed: int = 2) -> ImuSamples:
    return simulate_swing(replace(OPTIONS, scenario=scenario, seed=seed)).imu


def with_gyros(samples: ImuSamples, matrix: Array) -> ImuSamples:
    """What the gyros say, put through a matrix."""
    return ImuSamples(samples.stamp_ns, matrix @ samples.w_ib_b, samples.f_ib_b)


def run(samples: ImuSamples, grade: str = "rlg") -> tuple[Session, list[Update]]:
    values = {"latitude_deg": 40.0, "altitude_m": 50.0, "imu_grade": grade}
    session = Session(swing_config(values))
    return session, session.add_imu(samples)


def first_time(updates: list[Update], key: str) -> float:
    return next((u.status.elapsed_s for u in updates if key in u.status.keys), np.inf)


def blocks(samples: ImuSamples) -> list[ImuBlock]:
    """Of a second."""
    starts = range(0, len(samples) - 50, 50)
    parts = (samples.select(slice(k, k + 51)) for k in starts)
    return [ImuBlock(*part) for part in parts]


def watched(samples: ImuSamples) -> tuple[UnitsWatch, list[tuple[str, str]]]:
    """A watch alone, and what it found after every block."""
    watch, found = UnitsWatch(ImuSampling.INSTANTANEOUS), []
    for block in blocks(samples):
        watch.update(block)
        found.append(
            (
                "" if watch.fault is None else watch.fault.reason.key,
                "" if watch.hint is None else watch.hint.reason.key,
            )
        )
    return watch, found


# -- degrees


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_gyros_in_degrees_are_found(scenario: str) -> None:
    session, updates = run(with_gyros(imu(scenario), np.eye(3) / DEG))
    assert first_time(updates, "gyro_in_degrees") <= VERDICTS[-1] + 1.0
    late = [u.status for u in updates if u.status.elapsed_s > 61.0]
    assert {s.state for s in late} == {State.FAILED}
    assert State.ALIGNED not in {u.status.state for u in updates}
    assert session.estimate is None
    assert "multiply by 0.0174533" in session.status.remedy
    assert "they give degrees, not radians" in session.status.reason


@pytest.mark.parametrize("scenario", ["still", "pitch"])
def test_mended_it_begins_anew_and_gets_aligned(scenario: str) -> None:
    """In degrees for 100 s: said until the half minute that ends at 120 s, or the next one."""
    right = simulate_swing(replace(OPTIONS, scenario=scenario, duration_s=300.0)).imu
    w = right.w_ib_b.copy()
    w[:, :5000] /= DEG
    session, updates = run(ImuSamples(right.stamp_ns, w, right.f_ib_b))
    faulty = [u.status.elapsed_s for u in updates if "gyro_in_degrees" in u.status.keys]
    assert faulty[0] == pytest.approx(30.0, abs=1.5)
    assert 100.0 < faulty[-1] < 151.0
    first = next(u for u in updates if u.estimate is not None and u.status.elapsed_s > 100.0)
    assert first.status.elapsed_s > faulty[-1]
    assert session.status.state is State.ALIGNED
    assert session.status.elapsed_s > 290.0


def test_while_it_is_wrong_it_is_looked_for_every_half_minute() -> None:
    samples = with_gyros(imu("still"), np.eye(3) / DEG)
    _, found = watched(samples)
    assert [fault for fault, _ in found[:29]] == [""] * 29
    assert {fault for fault, _ in found[29:]} == {"gyro_in_degrees"}
    # Right again after 40 s: no more so with the half minute that ends at 90 s.
    w = samples.w_ib_b.copy()
    w[:, 2000:] = imu("still").w_ib_b[:, 2000:]
    watch, found = watched(ImuSamples(samples.stamp_ns, w, samples.f_ib_b))
    assert found[-1] == ("", "") and watch.fault is None
    cleared = [fault for fault, _ in found].index("", 30) + 1
    assert cleared in (60, 90)


# -- right data


@pytest.mark.parametrize("scenario", SCENARIOS)
@pytest.mark.parametrize("seed", [2, 3])
def test_right_data_never(scenario: str, seed: int) -> None:
    watch, found = watched(imu(scenario, seed))
    assert set(found) == {("", "")}
    assert watch.fault is None and watch.hint is None


@pytest.mark.parametrize("scenario", ["still", "pitch", "erect"])
@pytest.mark.parametrize("sampling", ["mean", "instantaneous"])
def test_a_tactical_grade_never(scenario: str, sampling: str) -> None:
    options = replace(OPTIONS, grade="tactical", scenario=scenario, sampling=sampling)
    watch = UnitsWatch(ImuSampling(sampling))
    for block in blocks(simulate_swing(options).imu):
        watch.update(block)
        assert watch.fault is None and watch.hint is None


def test_a_big_lever_arm_and_a_fast_swing_never() -> None:
    """The swing's own force tilts the measured one by a few degrees."""
    fast = replace(
        SCENARIOS["level"], amplitude_deg=(3.0, 3.0, 3.0), frequency_hz=(1 / 4, 1 / 3, 1 / 5)
    )
    options = replace(OPTIONS, scenario=fast, lever_arm_m=(3.0, -2.0, 2.0))
    samples = simulate_swing(options).imu
    assert np.abs(samples.f_ib_b[:2]).max() > 1.0
    watch, found = watched(samples)
    assert {fault for fault, _ in found} == {""}
    assert watch.hint is None


def test_a_base_that_turns_about_never() -> None:
    options = replace(OPTIONS, scenario="still", turn_deg=90.0, turn_start_s=10.0)
    _, found = watched(simulate_swing(options).imu)
    assert set(found) == {("", "")}


# -- axes

SWAPS = {
    "x and y swapped": np.eye(3)[[1, 0, 2]],
    "right-forward-up": np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
    "y turned": np.diag([1.0, -1.0, 1.0]),
    "all turned": -np.eye(3),
}


@pytest.mark.parametrize("name", SWAPS)
@pytest.mark.parametrize("scenario", ["pitch", "level"])
def test_other_axes_are_told_on_a_swinging_base(name: str, scenario: str) -> None:
    session, updates = run(with_gyros(imu(scenario), SWAPS[name]))
    assert first_time(updates, "axes_differ") <= VERDICTS[-1] + 5.0
    assert State.ALIGNED not in {u.status.state for u in updates}
    assert "axes_differ" in session.status.keys
    assert "axes and signs" in session.status.remedy
    assert "the gyros, instead of explaining it" in session.status.reason


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("scenario", ["pitch", "erect", "level"])
def test_a_sign_turned_is_never_aligned(axis: int, scenario: str) -> None:
    """About up the tilt does not show it; the estimate does."""
    signs = np.ones(3)
    signs[axis] = -1.0
    _, updates = run(with_gyros(imu(scenario), np.diag(signs)))
    assert State.ALIGNED not in {u.status.state for u in updates}


def test_both_turned_alike_is_right() -> None:
    """An IMU may be mounted as it likes."""
    samples, matrix = imu("pitch"), SWAPS["right-forward-up"]
    turned = ImuSamples(samples.stamp_ns, matrix @ samples.w_ib_b, matrix @ samples.f_ib_b)
    session, updates = run(turned)
    assert first_time(updates, "axes_differ") == np.inf
    assert session.status.state is State.ALIGNED


@pytest.mark.parametrize("scenario", ["ring", "figure8", "urban", "moving_start"])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_drive_never(scenario: str, seed: int) -> None:
    """In a turn the measured force leans, and the gyros rightly do not."""
    _, updates = align(vehicle(scenario, 70.0, rate_hz=50.0, grade="rlg", seed=seed))
    said = {key for update in updates for key in update.status.keys}
    assert not said & {"axes_differ", "gyro_in_degrees"}


@pytest.mark.parametrize("scenario", ["ring", "figure8", "straight"])
def test_nor_one_that_is_begun_on_the_way(scenario: str) -> None:
    """On a steady circle the force turns with the vehicle: read as degrees, it would stand."""
    imu = vehicle(scenario, 160.0, rate_hz=50.0, grade="rlg", seed=1).imu
    for start in range(0, 100, 5):
        watch = UnitsWatch(ImuSampling.INSTANTANEOUS, is_driving=True)
        for block in blocks(imu.select(slice(50 * start, 50 * (start + 60) + 1))):
            watch.update(block)
            assert watch.fault is None and watch.hint is None


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_degrees_of_a_vehicle_that_may_drive_are_found_while_it_stands(seed: int) -> None:
    samples = vehicle("static", 70.0, rate_hz=50.0, grade="fog", seed=seed).imu
    watch = UnitsWatch(ImuSampling.INSTANTANEOUS, is_driving=True)
    for block in blocks(with_gyros(samples, np.eye(3) / DEG)):
        watch.update(block)
    assert watch.fault is not None and watch.fault.reason.key == "gyro_in_degrees"
