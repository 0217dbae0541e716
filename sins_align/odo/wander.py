"""The wander-azimuth filters: no heading is needed to begin with.

`wander_kf` has the errors of both horizontal components of the Earth's axis as states, those
of cos L sin alpha and cos L cos alpha: the model is linear whatever the azimuth is.
`wander_ekf` has one, that of alpha itself, and is linearised about the estimate. When the
azimuth is known well, `wander_kf` becomes that small-angle model too: the length of the
components, which is cos L, is then imposed for good. Zhao and Qi; docs/odo.md.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sins_align.grades import ImuGrade
from sins_align.odo.azimuth import Azimuth, find_azimuth
from sins_align.odo.distribution import Expected, Forecast, Posterior
from sins_align.odo.epoch import AidedEpoch
from sins_align.odo.fading import ScaleJumpFading
from sins_align.odo.filter import FINE_VARIANCE, AidedFilter
from sins_align.odo.latitude import LengthError, latitude_of_axis, latitude_of_length
from sins_align.odo.layout import ALPHA, AZIMUTH, PHI, SIZE
from sins_align.odo.navigation import Course, WanderNavigation
from sins_align.odo.odometer_model import OdometerModel
from sins_align.odo.prior import shared_prior
from sins_align.odo.standing import Standing
from sins_align.types import Array, LatitudeEstimate

# Beyond so many squared sigma off the circle, P is not believed; up to there it is only what
# is given out that is widened, and for some epochs more.
FAR_OFF = 25.0
EXCESS_MEMORY = 0.97

# Mean normalised innovation squared over its expectation, up to which sigma of the latitude is
# believed: of an outlier in the first seconds it knows nothing.
FITTING = 1.2
MUCH_BETTER = 0.5

_BOTH_AZIMUTHS = np.eye(3, 2)
_NOTHING = np.zeros(3)


class HandOver(NamedTuple):
    """The step from two azimuth states to one.

    e_h, tangent, moved : (2,) the Earth's axis on its circle, by how much an azimuth moves it
        there, and by how much it has been moved
    correction : (n,) of the other errors
    """

    e_h: Array
    tangent: Array
    moved: Array
    correction: Array


class WanderFilter(AidedFilter):
    """A wander-azimuth filter.

    one_azimuth : whether the azimuth is one state (small-angle model) or two
    latitude : by the length of the Earth's horizontal part, while it is free: the best one
        so far; None before there is one
    hand_over, scaled : what the last epoch did beyond its step: None and 1.0 are nothing

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
        variance, sensors = shared_prior(
            grade, navigation.C_ab[2], odometer, level_sigma, velocity_sigma
        )
        super().__init__(SIZE, navigation, odometer, sensors, grade, ScaleJumpFading())
        self.one_azimuth = azimuth_sigma is not None
        self.latitude: LatitudeEstimate | None = None
        self.hand_over: HandOver | None = None
        self.scaled = 1.0  # P, by so much
        self._better = math.inf  # sigma from which on another latitude takes its place [rad]
        self._excess = 1.0  # by how much the azimuth says that P is too small
        if azimuth_sigma is None:
            azimuth = np.full(2, 0.5 * self.cos_latitude**2)
        else:
            azimuth = np.array([azimuth_sigma**2, 0.0])
        self.P = np.diag(np.concatenate((variance, azimuth)))

    @property
    def is_fine(self) -> bool:
        """See `AidedFilter`."""
        return self.one_azimuth and bool(self.P[ALPHA, ALPHA] < FINE_VARIANCE)

    def process(self, epoch: AidedEpoch, standing: Standing) -> bool:
        """See `AidedFilter`."""
        self.hand_over, self.scaled = None, 1.0
        stands = super().process(epoch, standing)
        if not self.one_azimuth:
            self._look_at_circle()
        return stands

    def _propagate(self, A: Array, course: Course) -> tuple[Array, Array]:
        if self._length is not None:
            self._length.propagate(A)
        return np.zeros(A.shape[0]), A @ self.P @ A.T

    def _expect(self, forecast: Forecast, H: Array, path: Array) -> Expected:
        cross = forecast.P @ H.T
        return Expected(_NOTHING, cross, H @ cross)

    def _look_at_circle(self) -> None:
        """Remember an azimuth that is off its circle for a while; far off, start to learn anew."""
        self._excess = max(1.0, EXCESS_MEMORY * self._excess)
        excess = self.azimuth().excess
        if excess > FAR_OFF:
            self.P *= excess
            self.scaled = excess
            # With a wrong latitude that will come again and again: what has told so stays. If it
            # was P that lied, P will soon be smaller by far.
            self._better *= MUCH_BETTER
            excess = 1.0
        self._excess = excess

    def _correct(self, dx: Array) -> None:
        self._correct_shared(dx)
        e = self.navigation.e_a.copy()
        if self.one_azimuth:
            alpha = math.atan2(e[0], e[1]) - float(dx[ALPHA])
            length = math.sqrt(max(1.0 - float(e[2]) ** 2, 0.0))
            e[:2] = length * math.sin(alpha), length * math.cos(alpha)
        else:
            e[:2] -= dx[AZIMUTH]
        self.navigation.e_a = e
        self._note_latitude()
        if not self.one_azimuth:
            # The sum of the variances of sin and cos. To impose their circle any earlier costs
            # 14 deg for good, as it is a curve and not a line.
            variance = float(self.P[AZIMUTH, AZIMUTH].trace())
            if variance < FINE_VARIANCE * self.cos_latitude**2:
                self._hand_over()

    def _note_latitude(self) -> None:
        """Keep the best latitude that the data have told, while the innovations fit."""
        if not self.consistency < FITTING:
            return
        e, given, length = self.navigation.e_a[:2], self.navigation.latitude, self._length
        found = None
        if not self.one_azimuth:
            found = latitude_of_axis(e, self.P[AZIMUTH, AZIMUTH], given)
        elif length is not None:
            sigma = 1.0 / math.sqrt(length.information)
            found = latitude_of_length(math.hypot(*e.tolist()) - length.r, sigma, given)
        if found is not None and found.sigma < self._better:
            self.latitude, self._better = found, found.sigma

    def _axis(self) -> Array:
        if not self.one_azimuth:
            return _BOTH_AZIMUTHS
        ex, ey, _ = self.navigation.e_a.tolist()
        # The second one, its length, has no variance: see `LengthError`.
        length = self.cos_latitude
        return np.array([[ey, ex / length], [-ex, ey / length], [0.0, 0.0]])

    def posterior(self) -> Posterior:
        """See `AidedFilter`: the length of the Earth's axis is taken into account.

        C_nb = Rz(alpha) C_ab: an azimuth too large turns counter-clockwise.
        """
        azimuth = self.azimuth()
        mean, P = self.with_one_azimuth(azimuth)
        phi_by_errors = np.zeros((3, SIZE))
        phi_by_errors[:, PHI] = np.eye(3)
        phi_by_errors[2, ALPHA] = -1.0
        return Posterior(azimuth.alpha, mean, P, phi_by_errors)

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
        self._length = self._length_error(azimuth)
        mean, self.P = self.with_one_azimuth(azimuth)
        self.one_azimuth = True
        moved = azimuth.e_h - self.navigation.e_a[:2]
        self.hand_over = HandOver(azimuth.e_h, azimuth.tangent, moved, mean)
        self.navigation.e_a[:2] = azimuth.e_h
        self._correct(mean)

    def _length_error(self, azimuth: Azimuth) -> LengthError:
        """That of the length which the hand-over imposes.

        With u, t along e_h and its tangent, J = P_ee^-1, G = P_xe J: where the length is too large
        by r, so is the azimuth by - t.J u / t.J t r, and the rest is off by G times both.
        """
        P, tangent = self.P[AZIMUTH, AZIMUTH], azimuth.tangent
        along = azimuth.e_h / self.cos_latitude
        J = np.linalg.inv(P)
        turned = -float(tangent @ J @ along) / float(tangent @ J @ tangent)
        V = self.P[:, AZIMUTH] @ J @ (along + turned * tangent)
        V[AZIMUTH] = turned, 1.0
        r = self.cos_latitude - float(along @ self.navigation.e_a[:2])
        return LengthError(V, r, float(along @ P @ along))
