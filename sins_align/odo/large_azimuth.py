"""Filters in ENU with an azimuth error U of any size.

Wu, Tang and Huang's error model: C_n^n' = (I - [phi_l x]) Rz(U), phi_l = (phi_E, phi_N, 0), and
the errors of velocity, position, biases and odometer, all of them computed minus true. Given U
it is linear: how its moments are found is what `sghf`, `ckf`, `ukf` and `ekf` differ in.

The axes are those of the navigation, ENU turned by a wander angle that is known: the true ones
are true ENU turned by the same, and stay so. The covariance of a start comes from a wander
filter, whose errors are these for a small U.
"""

from __future__ import annotations

import copy
import math

import numpy as np

from sins_align.config import OdometerConfig
from sins_align.earth import SEMI_MAJOR_AXIS
from sins_align.grades import ImuGrade
from sins_align.odo.distribution import Expected, Forecast, Posterior
from sins_align.odo.fading import Fading
from sins_align.odo.filter import FINE_VARIANCE, AidedFilter
from sins_align.odo.large_azimuth_model import MeasurementGivenU, StateGivenU, about_up
from sins_align.odo.layout import ALPHA, ENU_SIZE, PHI, PLACE, SHARED, SIZE, VELOCITY, U
from sins_align.odo.moments import MomentRule
from sins_align.odo.navigation import Course
from sins_align.odo.wander import WanderFilter
from sins_align.types import Array

# Of the position at the start [m].
PLACE_SIGMA = 10.0
# An azimuth known worse than this is not to start from [rad]; vehicles drive so fast [m/s].
START_SIGMA = math.radians(2.5)
START_SPEED = 15.0
# So many of the odometer's noise are averaged before U is known much better.
AVERAGED_EPOCHS = 16
# Where sigma becomes so many times that of a start, after a gap, say, the filter is given up.
LOST_RATIO = 2.0

_EYE = np.eye(3)
_PHI_BY_ERRORS = np.eye(3, ENU_SIZE)


class LargeAzimuthFilter(AidedFilter):
    """A filter of the large-azimuth model.

    Parameters
    ----------
    start : a wander filter; goes on unchanged
    grade : of the IMU; rule : how moments pass through the model; fading : strong tracking
    """

    def __init__(
        self, start: WanderFilter, grade: ImuGrade, rule: MomentRule, fading: Fading
    ) -> None:
        super().__init__(
            ENU_SIZE,
            copy.copy(start.navigation),
            copy.deepcopy(start.odometer),
            copy.copy(start.sensors),
            grade,
            fading,
        )
        self.consistency, self.nis, self.epochs = start.consistency, start.nis, start.epochs
        self._rule = rule
        self._most_variance = (LOST_RATIO * start_sigma(self.odometer.config)) ** 2
        azimuth = start.azimuth()
        mean, P = start.with_one_azimuth(azimuth)
        navigation = self.navigation
        navigation.e_a = np.array([*azimuth.e_h, navigation.e_a[2]])
        self._correct_shared(mean)
        J = _from_wander(navigation.v_a)
        self.P = J @ P @ J.T
        self.P[PLACE, PLACE] = PLACE_SIGMA**2 * _EYE

    @property
    def is_lost(self) -> bool:
        """Whether the azimuth is known worse than the model allows."""
        return not self.P[U, U] < self._most_variance

    @property
    def is_fine(self) -> bool:
        """See `AidedFilter`."""
        return bool(self.P[U, U] < FINE_VARIANCE)

    def posterior(self) -> Posterior:
        """See `AidedFilter`: everything has been fed back."""
        alpha = self.navigation.wander_angle
        return Posterior(alpha, np.zeros(ENU_SIZE), self.P, _PHI_BY_ERRORS)

    def _axis(self) -> Array:
        return _EYE

    def _axis_by_place(self) -> Array:
        """(3, 3) error of the true Earth's axis, in the true axes, by the position error [1/m].

        Latitude alone changes it: e = (cos L sin alpha, cos L cos alpha, sin L), and alpha is
        the same for both.
        """
        ex, ey, ez = self.navigation.e_a.tolist()
        cos_latitude = self.cos_latitude
        north = np.array([ex, ey, 0.0]) / cos_latitude
        by_latitude = np.array([0.0, 0.0, cos_latitude]) - ez * north
        return np.outer(by_latitude, north) / SEMI_MAJOR_AXIS

    def _propagate(self, A: Array, course: Course) -> tuple[Array, Array]:
        navigation = self.navigation
        ex, ey, ez = navigation.e_a.tolist()
        # ENU turns with the meridians: tan L / R by the velocity to the east.
        tan = ez / (self.cos_latitude**2 * course.radius)
        model = StateGivenU(
            A,
            v_start=course.v_start,
            v_end=navigation.v_a,
            path=course.path,
            e_a=navigation.e_a,
            axis_by_place=self._axis_by_place(),
            turn_by_path=tan * np.array([ey, -ex, 0.0]),
        )
        moments = self._rule(model, np.zeros(ENU_SIZE), self.P, U)
        return moments.mean, moments.covariance

    def _expect(self, forecast: Forecast, H: Array, path: Array) -> Expected:
        model = MeasurementGivenU(H, path, self.navigation.e_a, self._axis_by_place())
        moments = self._rule(model, forecast.mean, forecast.P, U)
        return Expected(moments.mean, moments.cross, moments.covariance)

    def _correct(self, dx: Array) -> None:
        """C_n'b with n' turned back: (I - [phi x]) Rz(U) is undone from the left.

        What is left of phi_l is then seen from axes turned by Rz(U)', and its covariance with
        it.
        """
        levels = dx.copy()
        levels[U] = 0.0
        self._correct_shared(levels)
        navigation = self.navigation
        back = about_up(dx[U : U + 1])[0].T
        navigation.C_ab = back @ navigation.C_ab
        P = self.P.copy()
        P[PHI, :] = back @ P[PHI, :]
        P[:, PHI] = P[:, PHI] @ back.T
        self.P = P
        navigation.e_a = navigation.e_a - self._axis_by_place() @ dx[PLACE]
        navigation.altitude -= float(dx[PLACE][2])


def start_sigma(odometer: OdometerConfig) -> float:
    """Largest 1 sigma of the azimuth to start from, for the errors in ENU to be Gaussian [rad].

    An azimuth error U makes an error v (1 - cos U) along the way, which no covariance with U
    holds. It stays, but is taken for noise of every epoch anew, and sigma becomes too small:
    1 sigma of it, v sigma_U^2 / sqrt(2), has to be below what the odometer's declared noise is
    in the mean of some epochs.
    """
    noise = float(odometer.noise[0] + odometer.noise_per_m[0] * START_SPEED)
    curved = noise / math.sqrt(AVERAGED_EPOCHS)
    return min(START_SIGMA, math.sqrt(math.sqrt(2.0) * curved / START_SPEED))


def _from_wander(v_a: Array) -> Array:
    """(ENU_SIZE, SIZE) the errors by those of a wander filter with one azimuth state.

    U = phi_z - dalpha; a true velocity that is seen from axes turned by dalpha has an error of
    dalpha x v.
    """
    J = np.zeros((ENU_SIZE, SIZE))
    J[:SHARED, :SHARED] = np.eye(SHARED)
    J[U, ALPHA] = -1.0
    x, y, _ = v_a.tolist()
    J[VELOCITY, ALPHA] = -y, x, 0.0
    return J
