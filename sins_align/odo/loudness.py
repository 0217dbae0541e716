"""Whether the gyros of a vehicle are noisier than declared.

A second filter of the same data takes their noise for `FACTOR` times what is declared: see
`noise_doubt`. It needs no navigation of its own. With the first one's estimates, whose errors are
x, it has m = E x, where the first one has zero, and P:

    m- = A m                  P- = A P A' + Q + (FACTOR^2 - 1) Q_gyro
    nu = nu_1 - H m-          S = H P- H' + R,  K = P- H' S^-1
    m+ = m- + K nu - dx_1     P+ = P- - K S K'

nu_1 and dx_1 are the first one's innovation and what it took off its estimates; R, that the
vehicle stands, and that the scale has jumped are as it found them. To the logarithm of the ratio an
epoch adds

    -1/2 (log det S - log det S_1 + nu' S^-1 nu - nu_1' S_1^-1 nu_1)

but one that the first filter found implausible adds nothing: what was made of it hangs on itself.
Ville's inequality allows for it: the second filter would let more of such epochs come.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dposv

from sins_align.noise_doubt import FACTOR, NoiseDoubt
from sins_align.odo.error_model import ErrorModel, ImuNoise
from sins_align.odo.filter import GAP_INDEX, Step
from sins_align.odo.guards import SOFT_LIMIT
from sins_align.odo.layout import ALPHA, AZIMUTH, SIZE
from sins_align.odo.layout import ODOMETER_SCALE as SCALE
from sins_align.odo.wander import HandOver, WanderFilter


class Loudness(NoiseDoubt):
    """The second filter, and what the two say.

    filter : the first one; P : (n, n) covariance of its errors by the second
    mean : (n,) the same errors as the second estimates them

    Parameters
    ----------
    noise : as the first one takes it
    """

    def __init__(self, filter_: WanderFilter, noise: ImuNoise) -> None:
        super().__init__()
        self.filter = filter_
        more = noise.gyro * (FACTOR * FACTOR - 1.0) ** 0.5
        self._more = ErrorModel(ImuNoise(more, 0.0, 0.0), SIZE)
        self.P, self.mean = filter_.P.copy(), np.zeros(SIZE)

    def follow(self) -> None:
        """After an epoch of the first filter."""
        step = self.filter.step
        assert step is not None
        added = self._take_in(step)
        self.note(self.log_ratio + added)
        self.P *= self.filter.scaled
        if self.filter.hand_over is not None:
            self._hand_over(self.filter.hand_over)

    def _take_in(self, step: Step) -> float:
        """Take in an epoch; what it adds to the logarithm of the ratio."""
        A, taken = step.A, step.taken
        if step.gap is not None:
            self.P[GAP_INDEX, GAP_INDEX] += step.gap
        P = A @ self.P @ A.T
        P += step.Q
        P += self._more.noise(step.duration_s)
        mean = A @ self.mean
        if taken is None:
            self.P, self.mean = P[:SIZE, :SIZE], mean[:SIZE]
            return 0.0
        if taken.jump is not None:
            P[SCALE, :] = P[:, SCALE] = 0.0
            P[SCALE, SCALE] = taken.jump
        cross = step.H @ P
        S = cross @ step.H.T + taken.R
        value = taken.value - step.H @ mean
        _, solved, _ = dposv(S, np.column_stack((cross[:, :SIZE], value)))
        P = P[:SIZE, :SIZE] - cross[:, :SIZE].T @ solved[:, :SIZE]
        self.P = 0.5 * (P + P.T)
        self.mean = mean[:SIZE] + cross[:, :SIZE].T @ solved[:, SIZE] - taken.correction
        nis = self.filter.nis
        if nis > SOFT_LIMIT or taken.jump is not None:
            return 0.0
        log_S, log_S1 = np.linalg.slogdet(np.stack((S, taken.S)))[1].tolist()
        return -0.5 * (log_S - log_S1 + float(value @ solved[:, SIZE]) - nis)

    def _hand_over(self, step: HandOver) -> None:
        """Go on with one azimuth state: the length of the Earth's axis is taken for known."""
        along = np.zeros(SIZE)
        along[AZIMUTH] = step.e_h
        cross = self.P @ along
        gain = cross / float(along @ cross)
        mean = self.mean - gain * float(along[AZIMUTH] @ step.moved + along @ self.mean)
        P = self.P - np.outer(gain, cross)
        mean[AZIMUTH] += step.moved
        by_two = np.eye(SIZE)
        by_two[AZIMUTH, AZIMUTH] = 0.0
        by_two[ALPHA, AZIMUTH] = step.tangent / float(step.tangent @ step.tangent)
        self.P, self.mean = by_two @ P @ by_two.T, by_two @ mean - step.correction
