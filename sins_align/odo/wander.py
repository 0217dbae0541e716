"""The wander-azimuth filters: closed-loop Kalman filters without a heading to begin with.

`wander_kf` has the errors of both horizontal components of the Earth's axis as states, those
of cos L sin alpha and cos L cos alpha: the model is linear whatever the azimuth is.
`wander_ekf` has one, that of alpha itself, and is linearised about the estimate. When the
azimuth is known well, `wander_kf` becomes that small-angle model too: the length of the
components, which is cos L, is then imposed for good. Zhao and Qi; docs/odo.md.
"""

from __future__ import annotations

import math

import numpy as np

from sins_align.grades import ImuGrade
from sins_align.odo.azimuth import Azimuth, find_azimuth
from sins_align.odo.epoch import AidedEpoch
from sins_align.odo.error_model import ErrorModel
from sins_align.odo.guards import SOFT_LIMIT, ScaleJump, inverse3, soften
from sins_align.odo.imu_model import (
    accel_variance,
    gap_noise,
    gyro_variances,
    imu_noise,
)
from sins_align.odo.layout import (
    ACCEL_BIAS,
    ALPHA,
    AZIMUTH,
    GYRO_BIAS,
    GYRO_TURN,
    ODOMETER,
    PATH,
    PHI,
    SIZE,
    VELOCITY,
)
from sins_align.odo.navigation import WanderNavigation
from sins_align.odo.odometer_model import LEVER as ODO_LEVER
from sins_align.odo.odometer_model import POSITION as ODO_POSITION
from sins_align.odo.odometer_model import SCALE, OdometerModel
from sins_align.odo.standing import Standing
from sins_align.rotation import exp_rotation, skew3, unskew3
from sins_align.types import Array

# Sum of the variances of sin and cos from which on their circle is imposed: earlier it
# costs 14 deg for good, as it is a curve and not a line.
HAND_OVER_VARIANCE = 1e-5
LEAST_COS_LATITUDE = 1e-6
CONSISTENCY_MEMORY = 0.95  # per epoch
MOST_INCONSISTENT = 20.0  # of one epoch
# What happened in a longer gap is no error at the epoch's start, as which it is added: the
# displacement of that epoch would be misread [s].
LONG_GAP_S = 0.12
# Beyond so many squared sigma off the circle, P is not believed; up to there it is only what
# is given out that is widened, and for some epochs more.
FAR_OFF = 25.0
EXCESS_MEMORY = 0.97
# The navigation's path in an epoch of standing: how far it may be from nothing.
STANDING_TOLERANCE = 0.01  # [m]
STANDING_LIMIT = 25.0  # of its normalised square

_EYE = np.eye(3)
_ONE_AND_A_HALF = 1.5 * _EYE
_ODOMETER_INDEX = np.arange(ODOMETER.start, ODOMETER.stop)
_POSITION_INDEX = _ODOMETER_INDEX[ODO_POSITION]
_SCALE = ODOMETER.start + SCALE
POSITION = slice(ODOMETER.start + ODO_POSITION.start, ODOMETER.start + ODO_POSITION.stop)


class WanderFilter:
    """The state of a wander-azimuth filter, from the start of an epoch on.

    navigation, odometer : the estimates; P : (SIZE, SIZE) covariance of their errors
    gyro_bias, accel_bias, gyro_turn : (3,) estimated [rad/s], [m/s^2], [1]
    one_azimuth : whether the azimuth is one state (small-angle model) or two
    consistency : mean normalised innovation squared over its expectation, of late
    nis, epochs : that of the last epoch measured, and how many epochs it has taken in
    accel_prior, accel_triad : (3,) prior variance of the accelerometers' biases, and what of it
        are scale errors and misalignments [m^2/s^4]

    Parameters
    ----------
    level_sigma, velocity_sigma : 1 sigma of the navigation's start [rad], [m/s]
    azimuth_sigma : 1 sigma of the azimuth of the navigation's e_a [rad]; None: unknown
    """

    def __init__(
        self,
        navigation: WanderNavigation,
        odometer: OdometerModel,
        grade: ImuGrade,
        level_sigma: float,
        velocity_sigma: float,
        azimuth_sigma: float | None = None,
    ) -> None:
        self.navigation = navigation
        self.odometer = odometer
        self.gyro_bias, self.accel_bias, self.gyro_turn = np.zeros((3, 3))
        self.one_azimuth = azimuth_sigma is not None
        self.consistency = math.nan
        self.nis = 0.0
        self.epochs = 0
        self._excess = 1.0  # by how much the azimuth says that P is too small
        self._model = ErrorModel(imu_noise(grade))
        self._jump = ScaleJump()
        up_b = navigation.C_ab[2]
        variance = np.zeros(SIZE)
        variance[PHI] = level_sigma**2, level_sigma**2, 0.0
        variance[VELOCITY] = velocity_sigma**2
        if azimuth_sigma is None:
            variance[AZIMUTH] = 0.5 * self.cos_latitude**2
        else:
            variance[AZIMUTH] = azimuth_sigma**2, 0.0
        variance[GYRO_BIAS], variance[GYRO_TURN] = gyro_variances(grade, up_b)
        self.accel_prior = accel_variance(grade, up_b)
        self.accel_triad = self.accel_prior - grade.accel_bias**2
        variance[ACCEL_BIAS] = self.accel_prior
        variance[ODOMETER] = odometer.prior_variance()
        self.P = np.diag(variance)

    @property
    def cos_latitude(self) -> float:
        """Of the place that the Earth's axis tells."""
        # At a pole, rounding carries the vertical part beyond 1.
        square = max(1.0 - float(self.navigation.e_a[2]) ** 2, 0.0)
        return max(math.sqrt(square), LEAST_COS_LATITUDE)

    @property
    def is_fine(self) -> bool:
        """Whether the azimuth is known as well as the small-angle model needs it."""
        return self.one_azimuth and bool(self.P[ALPHA, ALPHA] < HAND_OVER_VARIANCE)

    def bias(self, w_ib_b: Array) -> Array:
        """(6,) what is to be taken off the samples of an epoch with the rates w_ib_b (3, n+1)."""
        mean = w_ib_b[:, 1:].sum(axis=1) / (w_ib_b.shape[1] - 1)
        rate = float(self.navigation.C_ab[2] @ mean)
        return np.concatenate((self.gyro_bias + rate * self.gyro_turn, self.accel_bias))

    def process(self, epoch: AidedEpoch, standing: Standing) -> bool:
        """Take in an epoch; the biases must have been taken off its samples.

        With neither travel nor standing, or with samples missing for long, the errors grow, and
        nothing is measured. Returns whether it was taken as one of a vehicle that stands.
        """
        navigation, odometer, T = self.navigation, self.odometer, epoch.duration_s
        self.epochs += 1
        C_start = navigation.C_ab
        rate = float(C_start[2] @ unskew3(epoch.C_end)) / T
        axes_start = C_start @ odometer.C_bm
        position = axes_start @ odometer.x[ODO_POSITION]
        course = navigation.advance(epoch)
        factor, added = odometer.advance(T)
        basis = self._azimuth_basis()
        A = self._model.transition(epoch, course, basis, rate)
        A[_ODOMETER_INDEX, _ODOMETER_INDEX] = factor
        A[PATH, POSITION] = -axes_start
        if epoch.gap_s > 0.0:
            self.P = self.P + gap_noise(epoch)
        P = A @ self.P @ A.T
        P += self._model.noise(T)
        P[_ODOMETER_INDEX, _ODOMETER_INDEX] += added
        stands = standing is Standing.ASSUMED or (
            standing is Standing.POSSIBLE and self._may_stand(P, course.path - position)
        )
        axes = navigation.C_ab @ odometer.C_bm
        variance = odometer.position_sigma(stands) ** 2
        position_noise = axes * variance
        P[_POSITION_INDEX, _POSITION_INDEX] += variance
        P[PATH, POSITION] += position_noise
        P[POSITION, PATH] += position_noise.T
        P[PATH, PATH] += position_noise @ axes.T
        if (stands or epoch.travel is not None) and epoch.gap_s < LONG_GAP_S:
            turn = course.w_ia * T
            seen = odometer.measure(epoch, C_start, navigation.C_ab, course.path, turn, stands)
            H = self._model.within(epoch, course, basis, rate, odometer.x[ODO_LEVER])
            H[:, PHI] = skew3(seen.arm)
            H[:, ODOMETER] = seen.H
            H[:, PATH] = _EYE
            travel = None if stands else epoch.travel
            innovation = seen.residual - position
            S = self._update(P, H, seen.R, innovation, 0.0 if travel is None else travel.distance)
            if travel is not None:
                odometer.adapt(axes, innovation, S)
        else:
            self.P = P[:SIZE, :SIZE].copy()
        if not self.one_azimuth:
            self._look_at_circle()
        return stands

    def _look_at_circle(self) -> None:
        """Remember an azimuth that is off its circle for a while; far off, start to learn anew."""
        self._excess = max(1.0, EXCESS_MEMORY * self._excess)
        excess = self.azimuth().excess
        if excess > FAR_OFF:
            self.P *= excess
            excess = 1.0
        self._excess = excess

    def _may_stand(self, P: Array, path: Array) -> bool:
        """Whether the navigation's path (3,) may be none at all [m]."""
        S = P[PATH, PATH] + STANDING_TOLERANCE**2 * np.eye(3)
        return bool(path @ np.linalg.solve(S, path) < STANDING_LIMIT)

    def _update(self, P: Array, H: Array, R: Array, innovation: Array, distance: float) -> Array:
        """Kalman update of the extended covariance, with the guards; feeds the state back.

        distance : travelled [m]. Returns the innovation's covariance (3, 3), before an
        outlier has widened it.
        """
        PH = P @ H.T
        S = H @ PH
        inverse = inverse3(S + R)
        jump = self._jump.test(H[:, _SCALE], inverse, innovation, distance)
        if jump is not None:
            # The inflation goes where the mismatch is.
            P[_SCALE, :] = P[:, _SCALE] = 0.0
            P[_SCALE, _SCALE] = jump * jump
            PH = P @ H.T
            S = H @ PH
            inverse = inverse3(S + R)
        nis = float(innovation @ inverse @ innovation)
        if not math.isfinite(nis):
            raise np.linalg.LinAlgError("the filter broke down")
        self.nis = nis
        self._note(nis)
        if nis > SOFT_LIMIT:
            inverse = inverse3(soften(S, R, innovation, nis))
        PH = PH[:SIZE]
        gain = PH @ inverse
        P = P[:SIZE, :SIZE] - gain @ PH.T
        self.P = 0.5 * (P + P.T)
        self._correct(gain @ innovation)
        return S + R

    def _note(self, nis: float) -> None:
        # An outlier that has lost its weight must not stand for all that come after it.
        share = min(nis / 3.0, MOST_INCONSISTENT)
        if math.isnan(self.consistency):
            self.consistency = share
        self.consistency += (1.0 - CONSISTENCY_MEMORY) * (share - self.consistency)

    def _correct(self, dx: Array) -> None:
        """Take estimated errors (SIZE,) off the estimates."""
        navigation = self.navigation
        C = exp_rotation(dx[PHI]) @ navigation.C_ab
        navigation.C_ab = C @ (_ONE_AND_A_HALF - 0.5 * (C.T @ C))  # stays orthogonal
        navigation.v_a = navigation.v_a - dx[VELOCITY]
        e = navigation.e_a.copy()
        if self.one_azimuth:
            alpha = math.atan2(e[0], e[1]) - float(dx[ALPHA])
            length = math.sqrt(max(1.0 - float(e[2]) ** 2, 0.0))
            e[:2] = length * math.sin(alpha), length * math.cos(alpha)
        else:
            e[:2] -= dx[AZIMUTH]
        navigation.e_a = e
        # These errors are what is left in the samples: true minus estimated.
        self.gyro_bias = self.gyro_bias + dx[GYRO_BIAS]
        self.accel_bias = self.accel_bias + dx[ACCEL_BIAS]
        self.gyro_turn = self.gyro_turn + dx[GYRO_TURN]
        self.odometer.x = self.odometer.x - dx[ODOMETER]
        if not self.one_azimuth:
            variance = float(self.P[AZIMUTH, AZIMUTH].trace())
            if variance < HAND_OVER_VARIANCE * self.cos_latitude**2:
                self._hand_over()

    def _azimuth_basis(self) -> Array:
        """(2, 2) error of the horizontal part of e_a by the azimuth states."""
        if not self.one_azimuth:
            return np.eye(2)
        ex, ey, _ = self.navigation.e_a.tolist()
        return np.array([[ey, 0.0], [-ex, 0.0]])

    def azimuth(self) -> Azimuth:
        """The azimuth, given that the Earth's axis has the length that it has."""
        e = self.navigation.e_a
        if self.one_azimuth:
            sigma = math.sqrt(max(float(self.P[ALPHA, ALPHA]), 0.0))
            alpha = math.atan2(e[0], e[1])
            return Azimuth(alpha, sigma, e[:2].copy(), np.array([e[1], -e[0]]))
        return find_azimuth(e[:2], self.P[AZIMUTH, AZIMUTH], self.cos_latitude, self._excess)

    def _conditioned(self, azimuth: Azimuth) -> tuple[Array, Array, Array]:
        """The errors of two azimuth states once the azimuth is on its circle.

        Returns
        -------
        (SIZE,) their mean, (SIZE,) what an error of the azimuth does to them, and (SIZE,
        SIZE) the covariance of the rest
        """
        gain = np.linalg.solve(self.P[AZIMUTH, AZIMUTH], self.P[AZIMUTH, :]).T
        mean = gain @ (self.navigation.e_a[:2] - azimuth.e_h)
        return mean, gain @ azimuth.tangent, self.P - gain @ self.P[AZIMUTH, :]

    def with_one_azimuth(self, azimuth: Azimuth) -> tuple[Array, Array]:
        """The errors' mean (SIZE,) and covariance (SIZE, SIZE) in the small-angle model."""
        if self.one_azimuth:
            return np.zeros(SIZE), self.P
        mean, column, rest = self._conditioned(azimuth)
        mean[AZIMUTH] = 0.0
        column[AZIMUTH] = 1.0, 0.0
        rest[AZIMUTH, :] = rest[:, AZIMUTH] = 0.0
        return mean, azimuth.excess * rest + azimuth.sigma**2 * np.outer(column, column)

    def _hand_over(self) -> None:
        """Go on with one azimuth state; nothing that is given out changes by it."""
        azimuth = self.azimuth()
        mean, self.P = self.with_one_azimuth(azimuth)
        self.one_azimuth = True
        self.navigation.e_a[:2] = azimuth.e_h
        self._correct(mean)
