"""How a filter of `odo_align` starts: from the coarse alignment."""

from __future__ import annotations

import math

from sins_align.config import OdoConfig
from sins_align.odo.coarse import CoarseAligner, CoarseAttitude
from sins_align.odo.epoch import AidedEpoch, integrate_epoch
from sins_align.odo.navigation import WanderNavigation
from sins_align.odo.odometer_model import OdometerModel
from sins_align.odo.pairing import Paired
from sins_align.odo.wander import WanderFilter
from sins_align.types import Array, Position

# A filter starts with so many epochs at hand, for its levels.
START_EPOCHS = 3
# More are not kept: what came before a long silence is not waited for.
MOST_EPOCHS = 30
# Least sigma of the levels at the start [rad]: they come of epochs that the filter takes in
# again. Sigma of the velocity: absolute [m/s], and relative.
LEVEL_SIGMA = 0.01
VELOCITY_SIGMA = 0.2
VELOCITY_SHARE = 0.05


class Starter:
    """Collects epochs until the first filter, a wander filter, can be made.

    `wander_kf` begins at the first epoch with an odometer, level, and takes in again the
    epochs that told the levels. A filter that needs a heading begins where the coarse
    alignment knows it well enough.

    heading_sigma : 1 sigma of the heading that it needs [rad]; None: it needs none
    silent : epochs without odometer so far, before the first one with it
    collected_s : time since the first one with it [s]
    """

    def __init__(self, config: OdoConfig, position: Position, heading_sigma: float | None) -> None:
        self._config, self._position = config, position
        self._heading_sigma = heading_sigma
        self.silent = 0
        self.collected_s = 0.0
        self._begin()

    def _begin(self) -> None:
        config = self._config
        self._coarse = CoarseAligner(self._position, config.grade, config.odometer)
        self._early: list[Paired] = []
        self._first: AidedEpoch | None = None

    def add(self, paired: Paired, quantum: float) -> tuple[WanderFilter, list[Paired]] | None:
        """Take in an epoch; the filter, and the epochs that it is still to take in.

        quantum : of the odometer, as far as known [m]
        """
        epoch = integrate_epoch(paired, self._config.sampling)
        standing = self._config.stationary
        if self._first is None:
            if epoch.travel is None and not standing:
                self.silent += 1
                return None
            self._first = epoch
        self.collected_s += epoch.duration_s
        self._coarse.quantum = quantum
        self._coarse.add(epoch, standing)
        if self._heading_sigma is None:
            self._early.append(paired)
            if len(self._early) < START_EPOCHS:
                return None
        coarse = self._coarse.attitude
        if self._heading_sigma is not None:
            if coarse is None or not coarse.covariance[2, 2] < self._heading_sigma**2:
                return None
            return self._start_at_end(coarse, epoch), []
        if coarse is not None:
            return self._start_at_begin(coarse, self._first), self._early
        if len(self._early) > MOST_EPOCHS:
            self._begin()
        return None

    def _start_at_begin(self, coarse: CoarseAttitude, first: AidedEpoch) -> WanderFilter:
        """At the begin of the first epoch: level, and of no azimuth."""
        speed = 0.0 if first.travel is None else first.travel.speed_start
        return self._make_filter(coarse.C_n0b0, coarse, speed)

    def _start_at_end(self, coarse: CoarseAttitude, last: AidedEpoch) -> WanderFilter:
        """At the end of the last epoch, with ENU for a: alpha is zero."""
        speed = 0.0 if last.travel is None else last.travel.speed_end
        filter_ = self._make_filter(coarse.C_nb, coarse, speed, float(coarse.covariance[2, 2]))
        filter_.navigation.e_a[1] = math.cos(self._position.latitude)
        return filter_

    def _make_filter(
        self, C_ab: Array, coarse: CoarseAttitude, speed: float, variance: float | None = None
    ) -> WanderFilter:
        """The filter at an attitude and a forward speed; variance : of the azimuth."""
        odometer = OdometerModel(self._config.odometer)
        v_a = speed * (C_ab @ odometer.C_bm[:, 0])
        navigation = WanderNavigation(C_ab, v_a, self._position)
        level = max(LEVEL_SIGMA, math.sqrt(float(coarse.covariance.diagonal()[:2].max())))
        velocity = math.hypot(VELOCITY_SIGMA, VELOCITY_SHARE * speed)
        azimuth = None if variance is None else math.sqrt(variance)
        return WanderFilter(navigation, odometer, self._config.grade, level, velocity, azimuth)
