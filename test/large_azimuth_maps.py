"""The maps that a large-azimuth filter makes of an epoch, taken from one that runs.

What the filter makes of its navigation is tested with them.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from test_odo_wander import PERFECT

from sins_align.odo.epoch import AidedEpoch
from sins_align.odo.fading import Innovation
from sins_align.odo.large_azimuth import LargeAzimuthFilter
from sins_align.odo.large_azimuth_model import StateGivenU
from sins_align.odo.layout import ENU_SIZE, U
from sins_align.odo.moments import ConditionallyLinear, Linearised, Moments
from sins_align.odo.navigation import WanderNavigation
from sins_align.odo.odometer_model import OdometerModel
from sins_align.odo.standing import Standing
from sins_align.odo.wander import WanderFilter
from sins_align.types import Array

AZIMUTH_ERRORS = (-2.5, -0.6, 0.0, 0.05, 0.5, 1.5)
MILLIMETRE = 1e-3
every_angle = pytest.mark.parametrize("angle", AZIMUTH_ERRORS)


def turn(angle: float) -> Array:
    """Rz(U) = [c s 0; -s c 0; 0 0 1]."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


class Keeper:
    """A moment rule that keeps the maps, and a fading that keeps the residual.

    maps : of the state, then of the measurement; ends : C_ab and v_a computed when each was used
    """

    def __init__(self) -> None:
        self.maps: list[ConditionallyLinear] = []
        self.ends: list[tuple[Array, Array]] = []
        self.residual = self.path = np.full(3, np.nan)
        self.navigation: WanderNavigation | None = None
        self._expected = np.zeros(3)

    def __call__(self, map_: ConditionallyLinear, mean: Array, P: Array, index: int) -> Moments:
        assert index == U and self.navigation is not None
        self.maps.append(map_)
        self.ends.append((self.navigation.C_ab, self.navigation.v_a))
        if isinstance(map_, StateGivenU):
            self.path = map_.path
        moments = Linearised()(map_, mean, P, index)
        self._expected = moments.mean
        return moments

    def inflate(self, P: Array, Q: Array, innovation: Innovation, distance: float) -> None:
        self.residual = innovation.value + self._expected


def at_angle(map_: ConditionallyLinear, angle: float) -> tuple[Array, Array]:
    F, g = map_.at(np.array([angle]))
    return F[0], g[0]


def keep(navigation: WanderNavigation, odometer: OdometerModel, epoch: AidedEpoch) -> Keeper:
    """What a filter makes of an epoch, without any covariance: it corrects nothing before."""
    keeper = Keeper()
    wander = WanderFilter(navigation, odometer, PERFECT, 1.0, 1.0, 1.0)
    filter_ = LargeAzimuthFilter(wander, PERFECT, keeper, keeper)
    filter_.P = np.zeros((ENU_SIZE, ENU_SIZE))
    keeper.navigation = filter_.navigation
    filter_.process(epoch, Standing.NO)
    return keeper
