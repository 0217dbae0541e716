"""Large-azimuth filters of every method, started from a wander filter on the drive."""

from __future__ import annotations

import copy
from functools import cache

import numpy as np
import pytest
from test_odo_wander import (
    ALPHA,
    FOG,
    LEVER_ARM,
    MOUNTING_DEG,
    about_up,
    config,
    exact_epoch,
    make_filter,
    run_filter,
)

from sins_align.config import odo_config
from sins_align.odo.fading import Fading, NoFading
from sins_align.odo.filter import AidedFilter
from sins_align.odo.knowledge import Knowledge, knowledge_of
from sins_align.odo.large_azimuth import LargeAzimuthFilter, start_sigma
from sins_align.odo.methods import make_large_azimuth_filter
from sins_align.odo.moments import MomentRule
from sins_align.odo.standing import Standing
from sins_align.odo.wander import WanderFilter
from sins_align.types import Array

# As they are configured; `sghf` with each fading that is to be right.
METHODS: dict[str, dict[str, object]] = {
    "sghf": {"method": "sghf"},
    "sghf without fading": {"method": "sghf", "fading": "none"},
    "ghf": {"method": "ghf"},
    "ckf": {"method": "ckf"},
    "ekf": {"method": "ekf"},
    "ukf": {"method": "ukf"},
}
every_method = pytest.mark.parametrize("method", METHODS)


def turn(angle: float) -> Array:
    """Rz(U) = [c s 0; -s c 0; 0 0 1]."""
    return about_up(-angle)


def follow(wander: WanderFilter, method: str) -> LargeAzimuthFilter:
    parameters = {
        "imu_grade": "fog",
        "odometer_lever_arm_m": list(LEVER_ARM),
        "mounting_rpy_deg": list(MOUNTING_DEG),
    }
    return make_large_azimuth_filter(odo_config({**parameters, **METHODS[method]}), wander)


def with_rule(
    wander: WanderFilter, rule: MomentRule, fading: Fading | None = None
) -> LargeAzimuthFilter:
    return LargeAzimuthFilter(wander, FOG, rule, fading or NoFading())


@cache
def _found() -> tuple[WanderFilter, int]:
    filter_ = make_filter(ALPHA)
    for second in range(150):
        run_filter(filter_, second, second + 1)
        speed = float(np.linalg.norm(filter_.navigation.v_a))
        if knowledge_of(filter_).covariance[2, 2] < start_sigma(config()) ** 2 and speed > 5.0:
            return filter_, second + 1
    raise AssertionError("no start")


def at_start() -> tuple[WanderFilter, int]:
    """A wander filter of two azimuth states, on the move, from which one may start; the second."""
    filter_, second = _found()
    assert not filter_.one_azimuth
    return copy.deepcopy(filter_), second


@cache
def _handed_over() -> tuple[WanderFilter, int]:
    filter_, second = at_start()
    while not filter_.one_azimuth or np.linalg.norm(filter_.navigation.v_a) < 5.0:
        run_filter(filter_, second, second + 1)
        second += 1
    return filter_, second


def handed_over() -> tuple[WanderFilter, int]:
    """As `at_start`, of one azimuth state."""
    filter_, second = _handed_over()
    return copy.deepcopy(filter_), second


STARTS = {"two azimuth states": at_start, "one azimuth state": handed_over}
every_start = pytest.mark.parametrize("start", STARTS)


def run_and_know(filter_: AidedFilter, begin: int, end: int) -> Knowledge:
    for second in range(begin, end):
        filter_.process(exact_epoch(second), Standing.NO)
    return knowledge_of(filter_)
