"""A vehicle that drives off in the middle of a swing alignment."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from sins_align.config import swing_config
from sins_align.rotation import dcm_from_quaternion, log_rotation
from sins_align.session import Session
from sins_align.simulate import SwingOptions, simulate_swing
from sins_align.types import State, Update

DRIVE_S, STOP_S = 90.0, 20.0
THRESHOLDS = {
    "rlg": {"heading_threshold_arcmin": 6.0, "level_threshold_arcsec": 60.0},
    "fog": {"heading_threshold_arcmin": 20.0, "level_threshold_arcsec": 120.0},
    "tactical": {"heading_threshold_arcmin": 420.0, "level_threshold_arcsec": 400.0},
}


def run(grade: str, **changes: Any) -> tuple[Session, list[Update], Any]:
    options = SwingOptions(
        **{"grade": grade, "seed": 3, "rate_hz": 50.0, "duration_s": 300.0, **changes}
    )
    simulated = simulate_swing(options)
    values = {"latitude_deg": options.latitude_deg, "imu_grade": grade, **THRESHOLDS[grade]}
    session = Session(swing_config(values))
    return session, session.add_imu(simulated.imu), simulated.truth


def times(updates: list[Update], key: str) -> list[float]:
    return [u.status.elapsed_s for u in updates if key in u.status.keys]


@pytest.mark.parametrize("grade", THRESHOLDS)
@pytest.mark.parametrize("scenario", ["still", "pitch", "level", "erect"])
@pytest.mark.parametrize("drive_m", [5.0, 60.0])
def test_a_drive_is_noticed_waited_for_and_begun_anew_after(
    scenario: str, grade: str, drive_m: float
) -> None:
    session, updates, truth = run(
        grade, scenario=scenario, drive_m=drive_m, drive_start_s=DRIVE_S, drive_duration_s=STOP_S
    )
    moving = times(updates, "vehicle_moves")
    # The smooth start takes some seconds to be a motion at all.
    assert DRIVE_S < moving[0] < DRIVE_S + 10.0
    assert DRIVE_S + STOP_S < moving[-1] < DRIVE_S + STOP_S + 25.0
    assert np.diff(moving).max() < 1.1  # all the way
    for update in updates:
        if moving[0] <= update.status.elapsed_s <= moving[-1]:
            assert update.status.state is State.WAITING and update.estimate is None
            assert "stop the vehicle" in update.status.remedy
    assert times(updates, "began_anew")[0] > moving[-1]
    # Of the time that the new one has had.
    early = next(u.status for u in updates if u.status.elapsed_s > moving[-1] + 20.0)
    late = updates[-1].status
    assert early.heading_limit > 1.2 * late.heading_limit > 0.0
    # Whatever is claimed is true, before and after.
    claims = [u for u in updates if u.status.state is State.ALIGNED]
    assert claims and claims[-1].status.elapsed_s > moving[-1]
    for update in claims:
        assert update.estimate is not None
        C_true = truth.C_nb_at(update.estimate.stamp_ns)
        phi = log_rotation(dcm_from_quaternion(update.estimate.q_nb) @ C_true.T)
        assert abs(phi[2]) < 4.0 * update.estimate.sigma[2]
    assert session.status.state is State.ALIGNED


@pytest.mark.parametrize(
    "changes",
    [{"heave_m": 0.2}, {"sway_m": 0.2}, {"sway_m": 0.1, "sway_period_s": 60.0},
     {"turn_deg": 180.0}, {"lost_fraction": 0.1}],
    ids=lambda changes: next(iter(changes)),
)  # fmt: skip
@pytest.mark.parametrize("scenario", ["still", "pitch", "level"])
def test_a_base_that_sways_or_turns_in_its_place_does_not_drive(
    scenario: str, changes: dict[str, float]
) -> None:
    for grade in ("rlg", "tactical"):
        _, updates, _ = run(grade, scenario=scenario, **changes)
        assert not times(updates, "vehicle_moves")


def test_a_drive_before_the_heading_is_known_begins_anew_too() -> None:
    session, updates, _ = run(
        "fog", scenario="level", drive_m=80.0, drive_start_s=38.0, drive_duration_s=10.0
    )
    assert times(updates, "vehicle_moves")
    assert session.status.state is State.ALIGNED
    assert session.estimate is not None and math.degrees(session.estimate.sigma[2]) < 1.0


@pytest.mark.parametrize("scenario", ["still", "pitch", "level"])
@pytest.mark.parametrize(("metres", "start_s", "length_s"), [(5.0, 12.0, 8.0), (60.0, 25.0, 20.0)])
def test_a_drive_in_the_first_minute(
    scenario: str, metres: float, start_s: float, length_s: float
) -> None:
    """The Earth's axis is not known yet: noticed within seconds, and begun anew at rest only."""
    session, updates, _ = run(
        "rlg", scenario=scenario, drive_m=metres, drive_start_s=start_s, drive_duration_s=length_s
    )
    moving = times(updates, "vehicle_moves")
    assert start_s < moving[0] < start_s + 8.0
    assert np.diff(moving).max() < 1.1  # all the way
    assert 0.0 < moving[-1] - (start_s + length_s) < 20.0
    assert (session.status.state, session.restarts) == (State.ALIGNED, 1)
