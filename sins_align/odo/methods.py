"""The methods of `odo_align`: which filter starts, and what follows it."""

from __future__ import annotations

import math

from sins_align.config import OdoConfig
from sins_align.odo.fading import Fading, NoFading, PublishedFading, ScaleJumpFading
from sins_align.odo.knowledge import knowledge_of
from sins_align.odo.large_azimuth import LargeAzimuthFilter, start_sigma
from sins_align.odo.moments import (
    Cubature,
    Linearised,
    MomentRule,
    ReducedGaussHermite,
    Unscented,
)
from sins_align.odo.publication import PUBLISH_CONSISTENCY
from sins_align.odo.wander import WanderFilter
from sins_align.parameter_table import LARGE_AZIMUTH_METHODS

# `wander_ekf` starts with a heading known so well: from 10 deg on it is not linear enough.
EKF_SIGMA = math.radians(3.0)


def has_large_azimuth(config: OdoConfig) -> bool:
    """Whether the method's filter is one of ENU, which a wander filter starts."""
    return config.method in LARGE_AZIMUTH_METHODS


def has_witness(config: OdoConfig) -> bool:
    """Whether the wander filter goes on beside it."""
    return has_large_azimuth(config) and config.coarse == "wander"


def coarse_sigma(config: OdoConfig) -> float | None:
    """1 sigma of the coarse heading that the first filter needs [rad]; None: it needs none."""
    if config.method == "wander_ekf":
        return EKF_SIGMA
    if has_large_azimuth(config) and not has_witness(config):
        return start_sigma(config.odometer)
    return None


def can_follow(config: OdoConfig, wander: WanderFilter) -> bool:
    """Whether the model of ENU is right for what is known, and that to be believed."""
    variance = float(knowledge_of(wander).covariance[2, 2])
    least = start_sigma(config.odometer) ** 2
    return variance < least and wander.consistency <= PUBLISH_CONSISTENCY


def make_large_azimuth_filter(config: OdoConfig, start: WanderFilter) -> LargeAzimuthFilter:
    """The filter of the method, from where `start` is."""
    return LargeAzimuthFilter(start, config.grade, _make_rule(config), _make_fading(config))


def _make_rule(config: OdoConfig) -> MomentRule:
    if config.method == "ckf":
        return Cubature()
    if config.method == "ukf":
        return Unscented()
    if config.method == "ekf":
        return Linearised()
    return ReducedGaussHermite(config.nodes)


def _make_fading(config: OdoConfig) -> Fading:
    if config.method != "sghf" or config.fading == "none":
        return NoFading()
    return ScaleJumpFading() if config.fading == "guarded" else PublishedFading()
