"""The skeleton of the aided filters: closed-loop Gaussian filters of one epoch after the other.

An epoch carries the navigation on, and the errors' distribution with it; the displacement by
the odometer, or that the vehicle stands, is compared with the navigation's; what is found of
the errors is taken off the estimates, so that their mean is zero when the next epoch begins.
What a filter adds is how mean and covariance pass through its error model: `_axis`,
`_propagate`, `_expect`, `_correct`; what it gives out: `posterior`; and `is_fine`.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import NamedTuple

import numpy as np

from sins_align.grades import ImuGrade
from sins_align.odo.distribution import Expected, Forecast, Posterior, Taken
from sins_align.odo.epoch import AidedEpoch
from sins_align.odo.error_model import ErrorModel
from sins_align.odo.fading import Fading, Innovation
from sins_align.odo.guards import SOFT_LIMIT, inverse3, soften
from sins_align.odo.imu_model import gap_noise, imu_noise
from sins_align.odo.latitude import LengthError
from sins_align.odo.layout import (
    ODOMETER,
    ODOMETER_POSITION,
    ODOMETER_SCALE,
    PHI,
    VELOCITY,
    path_of,
)
from sins_align.odo.navigation import Course, WanderNavigation
from sins_align.odo.odometer_model import LEVER as ODO_LEVER
from sins_align.odo.odometer_model import POSITION as ODO_POSITION
from sins_align.odo.odometer_model import OdometerModel
from sins_align.odo.prior import SensorErrors
from sins_align.odo.standing import Standing, may_stand
from sins_align.rotation import skew3, unskew3
from sins_align.types import Array

# The azimuth is known as well as the small-angle model needs it: its variance [rad^2].
FINE_VARIANCE = 1e-5
LEAST_COS_LATITUDE = 1e-6
CONSISTENCY_MEMORY = 0.95  # per epoch
MOST_INCONSISTENT = 20.0  # of one epoch
# What happened in a longer gap is no error at the epoch's start, as which it is added: the
# displacement of that epoch would be misread [s].
LONG_GAP_S = 0.12
# No variance of what is estimated here is as large, in any unit.
MOST_VARIANCE = 1e12

_EYE = np.eye(3)
_ODOMETER_INDEX = np.arange(ODOMETER.start, ODOMETER.stop)
_POSITION_INDEX = _ODOMETER_INDEX[ODO_POSITION]
GAP_INDEX = np.r_[PHI, VELOCITY]


class Step(NamedTuple):
    """What an epoch did to the covariance: see `process`.

    duration_s : its length; A : (n + 3, n), Q : (n + 3, n + 3) transition and its noise
    H, R : (3, n + 3), (3, 3) measurement and its noise; H is zero where nothing was measured
    gap : (6,) variances that a gap adds to PHI and VELOCITY at the start; None: there was none
    taken : None where nothing was measured
    """

    duration_s: float
    A: Array
    Q: Array
    H: Array
    R: Array
    gap: Array | None
    taken: Taken | None


class AidedFilter(ABC):
    """State of a filter, from the start of an epoch on.

    navigation, odometer, sensors : the estimates; P : (n, n) covariance of their errors
    consistency : mean normalised innovation squared over its expectation, of late
    nis, epochs : that of the last epoch measured, and how many epochs it has taken in
    step : what the last epoch did to P; None before there is one

    Parameters
    ----------
    size : number of states n
    """

    def __init__(
        self,
        size: int,
        navigation: WanderNavigation,
        odometer: OdometerModel,
        sensors: SensorErrors,
        grade: ImuGrade,
        fading: Fading,
    ) -> None:
        self.navigation = navigation
        self.odometer = odometer
        self.sensors = sensors
        self.P = np.zeros((size, size))
        self.consistency = math.nan
        self.nis = 0.0
        self.epochs = 0
        self.step: Step | None = None
        self._size, self._path = size, path_of(size)
        self._model = ErrorModel(imu_noise(grade), size)
        self._fading = fading
        self._A = np.zeros((size + 3, size))  # transition of the last epoch
        self._length: LengthError | None = None  # of the Earth's horizontal part, once imposed

    @property
    def cos_latitude(self) -> float:
        """Of the place that the Earth's axis tells."""
        # At a pole, rounding carries the vertical part beyond 1.
        square = max(1.0 - float(self.navigation.e_a[2]) ** 2, 0.0)
        return max(math.sqrt(square), LEAST_COS_LATITUDE)

    @property
    @abstractmethod
    def is_fine(self) -> bool:
        """Whether the azimuth is known as well as the small-angle model needs it."""

    @abstractmethod
    def posterior(self) -> Posterior:
        """What is known after the last epoch."""

    @abstractmethod
    def _axis(self) -> Array:
        """(3, n - SHARED) error of the Earth's axis by the states that tell it."""

    @abstractmethod
    def _propagate(self, A: Array, course: Course) -> tuple[Array, Array]:
        """Mean (n + 3,) and covariance of the errors at the end of an epoch, without its noise.

        A : (n + 3, n) the error model's transition; the navigation is at the end already
        """

    @abstractmethod
    def _expect(self, forecast: Forecast, H: Array, path: Array) -> Expected:
        """What to expect of the measurement.

        H : (3, n + 3) the measurement by the errors, linear in phi; path : (3,) the navigation's
            over the epoch [m]
        """

    @abstractmethod
    def _correct(self, dx: Array) -> None:
        """Take estimated errors (n,) off the estimates; `_correct_shared` helps."""

    def bias(self, w_ib_b: Array) -> Array:
        """(6,) what is to be taken off the samples of an epoch with the rates w_ib_b (3, n+1)."""
        mean = w_ib_b[:, 1:].sum(axis=1) / (w_ib_b.shape[1] - 1)
        rate = float(self.navigation.C_ab[2] @ mean)
        return self.sensors.bias(rate)

    def process(self, epoch: AidedEpoch, standing: Standing) -> bool:
        """Take in an epoch; the biases must have been taken off its samples.

        With neither travel nor standing, or with samples missing for long, the errors grow, and
        nothing is measured. Returns whether it was taken as one of a vehicle that stands.
        """
        navigation, odometer = self.navigation, self.odometer
        self.epochs += 1
        C_start = navigation.C_ab
        rate = float(C_start[2] @ unskew3(epoch.C_end)) / epoch.duration_s
        position = C_start @ (odometer.C_bm @ odometer.x[ODO_POSITION])
        course = navigation.advance(epoch)
        axis = self._axis()
        gap = gap_noise(epoch) if epoch.gap_s > 0.0 else None
        forecast = self._forecast(epoch, course, axis, rate, gap)
        stands = standing is Standing.ASSUMED or (
            standing is Standing.POSSIBLE
            and may_stand(course.path - position, forecast.P[self._path, self._path])
        )
        axes = navigation.C_ab @ odometer.C_bm
        self._add_position_noise(forecast, axes, odometer.position_sigma(stands) ** 2)
        if not (stands or epoch.travel is not None) or epoch.gap_s >= LONG_GAP_S:
            self.P = forecast.P[: self._size, : self._size].copy()
            self._correct(forecast.mean[: self._size])
            nothing = np.zeros((3, self._size + 3))
            # The model uses the array of A again.
            self.step = Step(epoch.duration_s, self._A.copy(), forecast.Q, nothing, _EYE, gap, None)
            return stands
        turn = course.w_ia * epoch.duration_s
        seen = odometer.measure(epoch, C_start, navigation.C_ab, course.path, turn, stands)
        H = self._model.within(epoch, course, axis, rate, odometer.x[ODO_LEVER])
        H[:, PHI] = skew3(seen.arm)
        H[:, ODOMETER] = seen.H
        H[:, self._path] = _EYE
        travel = None if stands else epoch.travel
        distance = 0.0 if travel is None else travel.distance
        residual = seen.residual - position
        innovation, taken = self._update(forecast, H, seen.R, residual, course.path, distance)
        self.step = Step(epoch.duration_s, self._A.copy(), forecast.Q, H, seen.R, gap, taken)
        if travel is not None:
            odometer.adapt(axes, innovation.value, innovation.S + innovation.R)
        return stands

    def _forecast(
        self, epoch: AidedEpoch, course: Course, axis: Array, rate: float, gap: Array | None
    ) -> Forecast:
        """The errors at the end of the epoch, but for the position noise there.

        gap : see `Step`

        Raises
        ------
        LinAlgError : the covariance has grown without bound, as it may by a published fading
        """
        odometer, T = self.odometer, epoch.duration_s
        factor, added = odometer.advance(T)
        A = self._model.transition(epoch, course, axis, rate)
        A[_ODOMETER_INDEX, _ODOMETER_INDEX] = factor
        A[self._path, ODOMETER_POSITION] = -(course.C_start @ odometer.C_bm)
        if gap is not None:
            P = self.P.copy()
            P[GAP_INDEX, GAP_INDEX] += gap
            self.P = P
        self._A = A
        mean, P = self._propagate(A, course)
        Q = self._model.noise(T).copy()
        Q[_ODOMETER_INDEX, _ODOMETER_INDEX] += added
        P += Q
        if not P.diagonal().max() < MOST_VARIANCE:
            raise np.linalg.LinAlgError("the filter broke down: its covariance is without bound")
        return Forecast(mean, P, Q)

    def _add_position_noise(self, forecast: Forecast, axes: Array, variance: Array) -> None:
        """That of the odometer at the end of the epoch: a state, and a part of the path.

        axes : (3, 3) C_am; variance : (3,) in m [m^2]
        """
        path = self._path
        noise = axes * variance
        for P in (forecast.P, forecast.Q):
            P[_POSITION_INDEX, _POSITION_INDEX] += variance
            P[path, ODOMETER_POSITION] += noise
            P[ODOMETER_POSITION, path] += noise.T
            P[path, path] += noise @ axes.T

    def _update(
        self, forecast: Forecast, H: Array, R: Array, residual: Array, path: Array, distance: float
    ) -> tuple[Innovation, Taken]:
        """Take in a measurement, with the guards; feeds the errors back.

        residual : (3,) what was measured, with noise R (3, 3); path : see `_expect`
        distance : travelled by the odometer [m]
        """
        innovation, expected = self._compare(forecast, H, R, residual, path)
        inflated = self._fading.inflate(forecast.P, forecast.Q, innovation, distance)
        jump = None
        if inflated is not None:
            jump = float(inflated[ODOMETER_SCALE, ODOMETER_SCALE])
            forecast = forecast._replace(P=inflated)
            innovation, expected = self._compare(forecast, H, R, residual, path)
        value, inverse = innovation.value, innovation.inverse
        nis = float(value @ inverse @ value)
        if not math.isfinite(nis):
            raise np.linalg.LinAlgError("the filter broke down")
        self.nis = nis
        self._note(nis)
        if nis > SOFT_LIMIT:
            total = soften(expected.S, R, value, nis)
            inverse, R = inverse3(total), total - expected.S
        n = self._size
        cross = expected.cross[:n]
        gain = cross @ inverse
        if self._length is not None:
            self._length.update(H, gain, value, inverse)
        P = forecast.P[:n, :n] - gain @ cross.T
        self.P = 0.5 * (P + P.T)
        correction = forecast.mean[:n] + gain @ value
        self._correct(correction)
        return innovation, Taken(value, innovation.S + innovation.R, R, correction, jump)

    def _compare(
        self, forecast: Forecast, H: Array, R: Array, residual: Array, path: Array
    ) -> tuple[Innovation, Expected]:
        expected = self._expect(forecast, H, path)
        value, S = residual - expected.z, expected.S
        return Innovation(value, S, R, inverse3(S + R), H), expected

    def _note(self, nis: float) -> None:
        # An outlier that has lost its weight must not stand for all that come after it.
        share = min(nis / 3.0, MOST_INCONSISTENT)
        if math.isnan(self.consistency):
            self.consistency = share
        self.consistency += (1.0 - CONSISTENCY_MEMORY) * (share - self.consistency)

    def _correct_shared(self, dx: Array) -> None:
        """Take the shared part of estimated errors (SHARED or more,) off the estimates."""
        self.navigation.correct(dx[PHI], dx[VELOCITY])
        self.sensors.correct(dx)
        self.odometer.x = self.odometer.x - dx[ODOMETER]
