"""The session of `odo_align` with its filter's knowledge kept, epoch by epoch."""

from __future__ import annotations

import math
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np

from sins_align import aligners
from sins_align.config import OdoConfig
from sins_align.odo.aligner import OdoAligner
from sins_align.odo.coarse import CoarseAttitude
from sins_align.odo.epoch import AidedEpoch
from sins_align.odo.filter import AidedFilter
from sins_align.odo.knowledge import knowledge_of
from sins_align.odo.large_azimuth import LargeAzimuthFilter
from sins_align.odo.layout import VELOCITY
from sins_align.odo.pairing import Paired
from sins_align.odo.start import Starter
from sins_align.odo.wander import WanderFilter
from sins_align.rotation import exp_rotation, heading_from_yaw, rpy_from_dcm
from sins_align.session import Session
from sins_align.types import Advance, Array, Position
from sins_align.units import DEG


class Start(NamedTuple):
    """The heading that the filter begins with.

    error_deg : of it, clockwise
    sigma_deg : the paper's extended Kalman filter, with so much uncertainty, and without what
        takes its large innovations for outliers: soft weighting, and a new beginning; None: the
        linear filter, for which the heading at the start is a mere choice of axes
    """

    error_deg: float
    sigma_deg: float | None = None


class Moment(NamedTuple):
    """What the filter that is given out knows after an epoch, whether it is published or not.

    velocity : (3,) of the IMU in ENU [m/s]; scale : error and its 1 sigma
    is_large : whether it is a filter of the large-azimuth model
    """

    stamp_ns: int
    C_nb: Array
    covariance: Array
    velocity: Array
    gyro_bias: Array
    accel_bias: Array
    scale: tuple[float, float]
    consistency: float
    published: bool
    is_large: bool


class TurnedStarter(Starter):
    """Starts with the heading that it is told; heading : the true one [rad]."""

    def __init__(self, config: OdoConfig, position: Position, start: Start, heading: float) -> None:
        super().__init__(config, position, None)
        self._start, self._heading = start, heading + start.error_deg * DEG

    def _start_at_begin(self, coarse: CoarseAttitude, first: AidedEpoch) -> WanderFilter:
        found = heading_from_yaw(rpy_from_dcm(coarse.C_n0b0)[2])
        turn = np.array([0.0, 0.0, found - self._heading])  # headings are clockwise
        coarse = coarse._replace(C_n0b0=exp_rotation(turn) @ coarse.C_n0b0)
        if self._start.sigma_deg is None:
            return super()._start_at_begin(coarse, first)
        speed = 0.0 if first.travel is None else first.travel.speed_start
        variance = (self._start.sigma_deg * DEG) ** 2
        filter_ = self._make_filter(coarse.C_n0b0, coarse, speed, variance)
        filter_.navigation.e_a[1] = math.cos(self._position.latitude)
        return filter_


class RecordedAligner(OdoAligner):
    """Keeps a `Moment` for each epoch."""

    def __init__(
        self, config: OdoConfig, position: Position, start: Start | None, heading: float
    ) -> None:
        super().__init__(config, position)
        self.moments: list[Moment] = []
        self._plain = start is not None and start.sigma_deg is not None
        if start is not None:
            self._starter = TurnedStarter(config, position, start, heading)

    def _is_stillborn(self, filter_: AidedFilter) -> bool:
        return not self._plain and super()._is_stillborn(filter_)

    def _take_in(self, paired: Paired, delay: float) -> Advance:
        step = super()._take_in(paired, delay)
        if self._filter is not None:
            self.moments.append(_moment(self._filter, step))
        return step


class RecordedSession(Session):
    """A session whose aligner keeps its moments; `start` and `heading` are for that."""

    def __init__(
        self, config: OdoConfig, start: Start | None = None, heading: float = math.nan
    ) -> None:
        self._begin_with = start, heading
        super().__init__(config)

    def _make_aligner(self, *arguments: Any) -> None:
        with patch.object(aligners, "make_odo_aligner", self._make_recorded):
            super()._make_aligner(*arguments)

    def _make_recorded(self, config: OdoConfig, position: Position) -> RecordedAligner:
        return RecordedAligner(config, position, *self._begin_with)

    @property
    def moments(self) -> list[Moment]:
        """Of the alignment that runs."""
        assert isinstance(self._aligner, RecordedAligner)
        return self._aligner.moments


def _moment(filter_: AidedFilter, step: Advance) -> Moment:
    known, navigation = knowledge_of(filter_), filter_.navigation
    posterior = filter_.posterior()
    s, c = math.sin(posterior.alpha), math.cos(posterior.alpha)
    C_na = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return Moment(
        step.stamp_ns,
        known.C_nb,
        known.covariance,
        C_na @ (navigation.v_a - posterior.mean[VELOCITY]),
        known.gyro_bias,
        known.accel_bias,
        (known.odometer.scale_error, known.odometer.scale_sigma),
        filter_.consistency,
        step.estimate is not None,
        isinstance(filter_, LargeAzimuthFilter),
    )
