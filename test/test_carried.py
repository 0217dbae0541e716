"""An attitude carried on by the IMU: the response to sensor errors against the thing itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sins_align.carried import Carried, Carrier, begin, carry, misalignment_covariance
from sins_align.earth import earth_rate_n, normal_gravity
from sins_align.grades import ImuGrade
from sins_align.rotation import dcm_from_rpy, exp_rotation, log_rotation
from sins_align.types import Array, ImuBlock, ImuSampling, Position
from sins_align.units import ARCSEC, DEG, PPM

PLACE = Position(40.0 * DEG)
START = dcm_from_rpy(0.02, -0.01, 0.7)
RATE_HZ, SECONDS = 50, 20
SCALE, MISALIGNMENT = 100.0 * PPM, 20.0 * ARCSEC


def turning_block(k: int, M: Array) -> ImuBlock:
    """Second k of a level turn at 10 deg/s, as gyros with I + M measure it."""
    t = k + np.arange(RATE_HZ + 1) / RATE_HZ
    C_0 = [exp_rotation(np.array([0.0, 0.0, 10.0 * DEG * s])) @ START for s in t]
    up = np.array([0.0, 0.0, 1.0])
    w = np.array([C.T @ (10.0 * DEG * up + earth_rate_n(PLACE.latitude)) for C in C_0]).T
    f = np.array([C.T @ (normal_gravity(PLACE.latitude) * up) for C in C_0]).T
    return ImuBlock(np.rint(t * 1e9).astype(np.int64), (np.eye(3) + M) @ w, f)


def carried_over(M: Array, carrier: Carrier) -> Carried:
    carried = begin(START, np.diag([1e-12] * 6), np.zeros(3))
    for k in range(SECONDS):
        carried = carry(carried, turning_block(k, M), carrier)
    return carried


CARRIER = Carrier(
    ImuGrade(gyro_scale=SCALE, misalignment=MISALIGNMENT),
    ImuSampling.INSTANTANEOUS, PLACE, drives=False,
)  # fmt: skip


def test_a_perfect_gyro_carries_the_attitude() -> None:
    C_nb = carried_over(np.zeros((3, 3)), CARRIER).C_nb
    true = exp_rotation(np.array([0.0, 0.0, 10.0 * DEG * SECONDS])) @ START
    assert np.abs(log_rotation(C_nb @ true.T)).max() < 0.05 * ARCSEC


@pytest.mark.parametrize("i", range(3))
@pytest.mark.parametrize("j", range(3))
def test_response_to_scale_errors_and_misalignments(i: int, j: int) -> None:
    M = np.zeros((3, 3))
    M[i, j] = 1e-4
    clean, off = carried_over(np.zeros((3, 3)), CARRIER), carried_over(M, CARRIER)
    phi = -log_rotation(off.C_nb @ clean.C_nb.T)
    assert phi == pytest.approx(-clean.turned[:, i, j] * 1e-4, abs=0.3 * ARCSEC)
    largest = np.abs(clean.turned).max()
    assert largest == pytest.approx(10.0 * DEG * SECONDS, rel=0.02)


def test_what_turns_add_to_sigma() -> None:
    """200 deg: the scale by 3.5 times itself in heading, the misalignment twice in level."""
    carried = carried_over(np.zeros((3, 3)), CARRIER)
    still = replace(CARRIER, grade=ImuGrade())
    grown = misalignment_covariance(carried, CARRIER) - misalignment_covariance(carried, still)
    east, north, up = np.sqrt(grown.diagonal())
    assert up == pytest.approx(10.0 * DEG * SECONDS * SCALE, rel=0.02)
    level = 2.0 * np.sin(0.5 * 10.0 * DEG * SECONDS) * MISALIGNMENT
    assert np.hypot(east, north) == pytest.approx(np.sqrt(2.0) * level, rel=0.05)


def test_one_sample_carries_nowhere() -> None:
    start = begin(START, np.eye(6), np.zeros(3))
    block = turning_block(0, np.zeros((3, 3)))
    alone = ImuBlock(block.stamp_ns[:1], block.w_ib_b[:, :1], block.f_ib_b[:, :1])
    assert carry(start, alone, CARRIER) is start
