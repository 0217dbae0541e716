"""Where a session has its position from, and what it does before it has one."""

from __future__ import annotations

import math
import tracemalloc

import pytest
from swing_sessions import CONFIG, POSITION, SECOND, config, imu, numbers, run, shifted

from sins_align.config import swing_config
from sins_align.session import Session
from sins_align.types import Position, State


def test_before_a_position_samples_are_counted_and_no_more() -> None:
    settings_ = swing_config({"imu_grade": "fog"})
    session, updates = run(imu(duration_s=5.0), settings_)
    assert not updates
    assert session.estimate is None and session.conclusion is None
    assert (session.status.state, session.status.reason) == (State.WAITING, "no latitude")
    assert "latitude_deg" in session.status.remedy
    assert session.counts.imu_samples == 501
    session.set_position(POSITION)
    assert session.position == POSITION
    rest = imu().select(slice(501, None))
    session.add_imu(rest)
    expected, _ = run(rest)
    assert numbers(session.estimate) == numbers(expected.estimate) != ()
    assert session.restarts == 0


def test_the_first_position_counts() -> None:
    session = Session(swing_config({"imu_grade": "fog"}))
    session.set_position(POSITION)
    session.add_imu(imu().select(slice(0, 2000)))
    before = numbers(session.estimate)
    session.set_position(Position(0.1))
    assert session.position == POSITION
    assert numbers(session.estimate) == before != ()


def test_a_configured_position_is_not_overruled_by_a_fix() -> None:
    session = Session(CONFIG)
    session.set_position(Position(-0.3))
    assert session.position is not None
    assert session.position.latitude == POSITION.latitude


@pytest.mark.parametrize(
    "position",
    [Position(math.nan), Position(1.6), Position(-1.6), Position(math.inf),
     Position(0.1, math.nan), Position(0.1, 0.0, math.inf)],
)  # fmt: skip
def test_no_position_on_the_earth(position: Position) -> None:
    session = Session(swing_config())
    with pytest.raises(ValueError, match="not a position"):
        session.set_position(position)
    assert session.position is None


@pytest.mark.parametrize("latitude_deg", [90.0, -90.0, 89.9])
def test_at_the_pole_there_is_no_heading_and_no_crash(latitude_deg: float) -> None:
    session, _ = run(imu(), config(latitude_deg=latitude_deg))
    assert session.status.state in (State.COARSE, State.FAILED)
    assert session.status.remedy
    assert session.conclusion is None


def test_without_a_position_memory_does_not_grow() -> None:
    session = Session(swing_config())
    samples = imu()
    tracemalloc.start()
    sizes = []
    for k in range(12):
        for at in range(0, 3000, 50):
            session.add_imu(shifted(samples.select(slice(at, at + 50)), k * 30 * SECOND))
        sizes.append(tracemalloc.get_traced_memory()[0])
    tracemalloc.stop()
    assert session.counts.imu_samples == 36_000
    # 36,000 samples are 2 MB; an open block is 6 kB.
    assert sizes[-1] - sizes[2] < 50_000
