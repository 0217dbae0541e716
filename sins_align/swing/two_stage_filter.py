"""The filter of the random part, with the sums that the constant part is solved from."""

from __future__ import annotations

from copy import copy

import numpy as np
from scipy.linalg.lapack import dposv

from sins_align.swing.position_noise import PositionNoise, judge
from sins_align.swing.two_stage import DRIFT, LEVER, POS, V0, VEL, NoiseModel, Steps
from sins_align.types import Array


class TwoStageFilter:
    """Filter of the random part, with the columns of its response to theta.

    x : the random part's estimate is X[:, :-1] theta + X[:, DATA]
    P : (n, n) its covariance for given theta
    normal : (p+1, p+1) sum of E^T S^-1 E
    log_det : sum of log det S
    variances : position noise that each epoch was taken in with [m^2]

    Parameters
    ----------
    noise : the densities
    position : the swing centre's noise as an earlier run found it, to begin with
    """

    PORTION = 10  # epochs between two looks at the innovations
    REDO = 1.5  # a portion is run again where its variance turns out to be so much larger,
    RETRIES = 4  # but not more often than this

    def __init__(self, noise: NoiseModel, position: PositionNoise | None = None) -> None:
        n = 12 if noise.drift > 0.0 else 9
        self.noise = position or PositionNoise(noise.position**2)
        self.columns = noise.theta_size + 1
        self._M = np.zeros((n, self.columns + n))
        self.X[VEL, V0] = self.X[POS, LEVER] = np.eye(3)
        self.P[POS, POS] = self.noise.variance * np.eye(3)
        if noise.drift > 0.0:
            self.P[DRIFT, DRIFT] = noise.drift**2 * np.eye(3)
        self.normal = np.zeros((self.columns, self.columns))
        self.log_det = 0.0
        self.variances: list[float] = []

    def copy(self) -> TwoStageFilter:
        """Another one in the same state."""
        other = copy(self)
        other._M, other.normal = self._M.copy(), self.normal.copy()
        other.variances = self.variances.copy()
        return other

    @property
    def X(self) -> Array:
        """(n, p + 1) response of the estimate to theta, and the data's part."""
        return self._M[:, : self.columns]

    @property
    def P(self) -> Array:
        """(n, n) covariance of the random part."""
        return self._M[:, self.columns :]

    def run(self, steps: Steps, theta: Array | None, theta_covariance: Array | None = None) -> None:
        """Take in epochs. With theta (p,) the innovations are judged and may grow R.

        theta_covariance : (p, p), where theta does not know these epochs yet: what its error
            adds to the innovations is no motion of the centre
        """
        for first in range(0, steps.F.shape[0], self.PORTION):
            part = Steps(*(a[first : first + self.PORTION] for a in steps))
            before, noise = self._M, self.noise
            for _ in range(self.RETRIES):
                variances = [self.noise.variance] * part.F.shape[0]
                E, SiE, S = self._run_portion(part, variances)
                if theta is None:
                    break
                judged = judge(noise, E, S, theta, theta_covariance)
                if judged.variance <= self.REDO * self.noise.variance:
                    self.noise = judged
                    break
                # The centre was less at rest than these epochs were weighted for: again.
                self._M = before
                self.noise = copy(noise)
                self.noise.variance, self.noise.has_grown = judged.variance, True
            else:
                variances = [self.noise.variance] * part.F.shape[0]
                E, SiE, S = self._run_portion(part, variances)
            self._sum_up(E, SiE, S, variances)

    def follow(self, steps: Steps, variances: list[float]) -> None:
        """Take in epochs with the position noise that another filter took them in with."""
        if variances:
            self._sum_up(*self._run_portion(steps, variances), variances)

    def _sum_up(self, E: Array, SiE: Array, S: Array, variances: list[float]) -> None:
        self.normal += E.reshape(-1, self.columns).T @ SiE.reshape(-1, self.columns)
        self.log_det += float(np.linalg.slogdet(S)[1].sum())
        self.variances += variances
        self._M[:, self.columns :] = 0.5 * (self.P + self.P.T)

    def _run_portion(self, steps: Steps, variances: list[float]) -> tuple[Array, Array, Array]:
        """Innovations E (K, 3, p+1), S^-1 E, and S (K, 3, 3)."""
        c = self.columns
        K = steps.F.shape[0]
        E, SiE = np.empty((K, 3, c)), np.empty((K, 3, c))
        S = np.empty((K, 3, 3))
        eye = np.eye(3)
        M = self._M
        for k, (F, added, H, observed) in enumerate(zip(*steps, strict=True)):
            M = F @ M
            M[:, c:] = M[:, c:] @ F.T
            M += added
            # H [X, P] in one product: innovations and the numerator of the gain.
            HM = H @ M
            HM += observed
            HP = HM[:, c:]
            S[k] = HP @ H.T + variances[k] * eye
            _, solved, _ = dposv(S[k], HM, lower=1)
            M -= HP.T @ solved
            E[k], SiE[k] = HM[:, :c], solved[:, :c]
        self._M = M
        return E, SiE, S
