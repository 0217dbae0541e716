"""A simulated swing through a session, and every bit of what comes out."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import pytest

from sins_align.config import SwingConfig, swing_config
from sins_align.session import Session
from sins_align.simulate import SwingOptions, simulate_swing
from sins_align.types import Estimate, ImuSamples, Position, Update
from sins_align.units import DEG

SECOND = 1_000_000_000
LATITUDE_DEG = 40.0
POSITION = Position(LATITUDE_DEG * DEG)
OPTIONS = SwingOptions(
    duration_s=30.0, rate_hz=100.0, grade="fog", seed=3, latitude_deg=LATITUDE_DEG
)
CONFIG = swing_config({"latitude_deg": LATITUDE_DEG, "imu_grade": "fog"})
METHODS = pytest.mark.parametrize("method", ["inertial", "paper"])


@functools.cache
def imu(**changes: object) -> ImuSamples:
    samples = simulate_swing(dataclasses.replace(OPTIONS, **changes)).imu
    for array in samples:
        array.flags.writeable = False  # the tests share them
    return samples


def copied(samples: ImuSamples) -> ImuSamples:
    return ImuSamples(*(x.copy() for x in samples))


def config(**changes: object) -> SwingConfig:
    return swing_config({"latitude_deg": LATITUDE_DEG, "imu_grade": "fog", **changes})


def short_paper() -> SwingConfig:
    return config(method="paper", level_phase_s=5.0, switch_times_s=[3.0, 8.0])


def config_of(method: str) -> SwingConfig:
    return short_paper() if method == "paper" else CONFIG


def shifted(samples: ImuSamples, by_ns: int) -> ImuSamples:
    return ImuSamples(samples.stamp_ns + by_ns, samples.w_ib_b, samples.f_ib_b)


def joined(*parts: ImuSamples) -> ImuSamples:
    return ImuSamples(
        np.concatenate([p.stamp_ns for p in parts]),
        np.concatenate([p.w_ib_b for p in parts], axis=1),
        np.concatenate([p.f_ib_b for p in parts], axis=1),
    )


def run(samples: ImuSamples, settings_: SwingConfig = CONFIG) -> tuple[Session, list[Update]]:
    session = Session(settings_)
    return session, session.add_imu(samples)


def numbers(estimate: Estimate | None) -> tuple[object, ...]:
    """Every bit of an estimate."""
    if estimate is None:
        return ()
    lever_arm = estimate.lever_arm
    return (
        estimate.stamp_ns,
        *(
            getattr(estimate, name).tobytes()
            for name in (
                "q_nb", "misalignment_covariance", "gyro_bias", "gyro_bias_sigma", "accel_bias",
                "accel_bias_sigma",
            )
        ),
        repr(estimate.consistency),
        *(() if lever_arm is None else (lever_arm.r_b.tobytes(), lever_arm.covariance.tobytes())),
    )  # fmt: skip


def trace(updates: list[Update]) -> list[tuple[object, ...]]:
    return [(u.stamp_ns, numbers(u.estimate), u.status) for u in updates]


def assert_add_up(session: Session, handed_over: int) -> None:
    counts = session.counts
    assert counts.imu_samples + counts.imu_rejected == handed_over
    assert min(counts.rejected.values()) >= 0
