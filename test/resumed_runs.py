"""Runs that go on from the result of another one."""

from __future__ import annotations

import functools
import json
from dataclasses import replace
from typing import Any

import numpy as np

from evidence.monte_carlo import make_config
from sins_align.config import OdoConfig, SwingConfig
from sins_align.ros.result import Timing, result_document, result_text
from sins_align.rotation import exp_rotation, quaternion_from_dcm
from sins_align.session import Session
from sins_align.simulate import SwingOptions, SwingRun, ThreeAxisSwing, simulate_swing
from sins_align.stored import StoredAlignment, stored_alignment
from sins_align.stored_check import CHECK_S
from sins_align.types import Array, Estimate, ImuSamples, Update
from sins_align.units import ARCSEC

SECOND = 1_000_000_000
# So that every grade gets there in a run that is short.
FIRST = {"heading_threshold_arcmin": 400.0, "level_threshold_arcsec": 400.0, "hold_s": 2.0}
STILL = SwingOptions(scenario="still", rate_hz=50.0, duration_s=150.0, heading_deg=30.0)
VEHICLES = 8


def still(tilt_deg: float = 0.0, swing_deg: float = 0.0) -> ThreeAxisSwing:
    return ThreeAxisSwing("still", (0.0, tilt_deg, 0.0), (swing_deg,) * 3)


def document_of(node: str, session: Session) -> dict[str, Any]:
    """The result file, through its text."""
    text = result_text(result_document(node, session, session.conclusion, Timing()))
    document: dict[str, Any] = json.loads(text)
    return document


def first_run(options: SwingOptions, **parameters: Any) -> tuple[SwingRun, StoredAlignment]:
    run = simulate_swing(options)
    session = Session(make_config(run, {**FIRST, **parameters}))
    session.add_imu(run.imu)
    return run, stored_alignment(document_of("swing_align", session))


def resume(
    config: SwingConfig | OdoConfig, stored: StoredAlignment, imu: ImuSamples
) -> tuple[Session, list[Update]]:
    session = Session(replace(config, initial=stored))
    return session, session.add_imu(imu)


def estimates_after_check(updates: list[Update], begin_ns: int) -> list[Estimate]:
    return [
        u.estimate
        for u in updates
        if u.estimate is not None and u.stamp_ns >= begin_ns + CHECK_S * SECOND
    ]


@functools.cache
def rlg_run() -> tuple[SwingRun, StoredAlignment]:
    return first_run(replace(STILL, grade="rlg", seed=5, duration_s=300.0))


def second_run(**changes: Any) -> SwingRun:
    return simulate_swing(replace(STILL, grade="rlg", seed=1005, duration_s=60.0, **changes))


WIND = {"scenario": still(swing_deg=2.8 / 60.0), "lever_arm_m": (0.0, 0.0, 0.0)}  # 2' rms


def known(run: SwingRun, sigma: float, turned: Array | None = None) -> StoredAlignment:
    """A stored alignment at the attitude of a base without motion, turned by a misalignment."""
    C_nb = run.truth.C_nb_at(int(run.imu.stamp_ns[0]))
    if turned is not None:
        C_nb = exp_rotation(-turned) @ C_nb
    return StoredAlignment(quaternion_from_dcm(C_nb), np.diag([ARCSEC**2, ARCSEC**2, sigma**2]))
