"""The filter behind the inertial-frame method, in its two-stage form.

In b0 axes (the body axes at the first sample, frozen in inertial space), with the origin at
the swing centre, the IMU's position d obeys

    C = (I + [phi x]) C^        phi' = -C^ (b_g + beta) - n_g
    d'' = C^ f - [F x] phi - C^ b_a - n_a + g(t)
    0 = d - C r - n_p = d - C^ r + [C^ r x] phi - n_p

with C^ the attitude by the raw gyros, F the specific force of the model and g(t) gravity,
which turns with the Earth:

    g(t) = -g [ R_u (1 - cos^2 L (1 - cos Wt)) + R_e cos L sin Wt + R_n sin L cos L (1 - cos Wt) ]

where R_e, R_n, R_u are east, north and up at t = 0 in b0 axes. The eighteen states of the
problem are phi, v, d, r, b_g, b_a; beta is the Gauss-Markov part of the gyro bias.

What is constant and unknown (attitude, start velocity, lever arm, biases) enters linearly in
theta = [R_e, R_n, R_u, v0, r, b_g, b_a, M_g, M_a], with no prior at all on most of it. M_g and
M_a are the scale errors and misalignments, which under a swing act as further biases: on a
cone they rectify. So, after
Friedland (IEEE TAC 14, 1969), the filter runs on the random part x = [phi, v, d, beta] alone,
which starts from zero with a small covariance, and carries beside it the columns X of its
response to theta. The innovations E theta + e whiten the problem, and their sums
E^T S^-1 E are all that the solution needs: no huge start covariance, hence no lost digits;
no linearisation about a wrong attitude, hence any attitude to start from; and what is to be
estimated, frozen or merely considered is decided when the sums are solved, not before.

F and the columns that hold it come from the model, not from the measured specific force: a
heading error that multiplies measured noise would come back as information about heading.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dpotrf, dtrtrs

from sins_align.rotation import skew, unskew
from sins_align.swing.epochs import Epochs
from sins_align.types import Array

# Columns of theta; those of the scale errors and misalignments are there where the grade has
# them; the last column is the data's.
R_EAST, R_NORTH, R_UP = slice(0, 3), slice(3, 6), slice(6, 9)
ATTITUDE = slice(0, 9)
V0, LEVER, GYRO_BIAS, ACCEL_BIAS = slice(9, 12), slice(12, 15), slice(15, 18), slice(18, 21)
GYRO_MATRIX, ACCEL_MATRIX = slice(21, 30), slice(30, 39)
BASE, CALIBRATED = 21, 39
DATA = -1
# Rows of x.
PHI, VEL, POS, DRIFT = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)


@dataclass(frozen=True)
class NoiseModel:
    """Densities of the random part.

    gyro [rad/sqrt(s)], accel [m/s/sqrt(s)], drift [rad/s] with drift_time_s [s],
    position [m] at an epoch, walk [m/sqrt(s)]
    calibration : whether scale errors and misalignments are among the unknowns
    """

    gyro: float
    accel: float
    drift: float
    drift_time_s: float
    position: float
    walk: float
    calibration: bool = False

    @property
    def theta_size(self) -> int:
        """Number of unknowns."""
        return CALIBRATED if self.calibration else BASE


@dataclass(frozen=True)
class GravityModel:
    """Gravity as it turns in inertial space: magnitude [m/s^2], latitude [rad], W [rad/s]."""

    magnitude: float
    latitude: float
    earth_rate: float

    def basis(self, time_s: Array) -> Array:
        """Factors of R_e, R_n, R_u in g(t): (N, 3) [m/s^2]."""
        c, s = np.cos(self.latitude), np.sin(self.latitude)
        angle = self.earth_rate * time_s
        versine = 2.0 * np.sin(0.5 * angle) ** 2
        return -self.magnitude * np.stack(
            (c * np.sin(angle), s * c * versine, 1.0 - c * c * versine), axis=-1
        )


class Linearisation(NamedTuple):
    """About what the noise model is linearised, and what the innovations are judged by.

    R : (3, 3) columns east, north, up in b0; r_b : (3,) lever arm; theta : (p,)
    """

    R: Array
    r_b: Array
    theta: Array


class Steps(NamedTuple):
    """Transition, its response to theta, process noise, observation: one epoch a row."""

    F: Array  # (K, n, n)
    G: Array  # (K, n, p + 1)
    Q: Array  # (K, n, n)
    H: Array  # (K, 3, n)
    C: Array  # (K, 3, 3) at the end of the epoch


def model_force(
    epochs: Epochs, first: int, about: Linearisation, gravity: Array
) -> tuple[Array, Array]:
    """int F dt and int int F dt dt over the epochs from `first` on: (K, 3) each.

    F = d'' - g(t) with d = C^ r: the difference of the model's velocity and position, less
    gravity. `gravity` : (K, 2, 3) single and double integral of g(t) over the epochs.
    """
    start = max(first - 1, 0)
    d = epochs.C[start:] @ about.r_b
    t = epochs.time_s[start:]
    # With fewer than three nodes the swing's share of F is not known yet.
    v = np.gradient(d, t, axis=0, edge_order=2) if t.shape[0] > 2 else np.zeros_like(d)
    d, v = d[first - start :], v[first - start :]
    T = epochs.duration_s[first:, None]
    u_m = v[1:] - v[:-1] - gravity[:, 0]
    s_m = d[1:] - d[:-1] - v[:-1] * T - gravity[:, 1]
    return u_m, s_m


def build_steps(
    epochs: Epochs, first: int, about: Linearisation, model: GravityModel, noise: NoiseModel
) -> Steps:
    """The steps of all epochs from `first` on, as arrays."""
    T = epochs.duration_s[first:]
    t = epochs.time_s[first:-1]
    K, n = T.shape[0], 12 if noise.drift > 0.0 else 9
    # Gravity is as good as linear within an epoch: exact moments of a linear function.
    u_g = model.basis(t + T / 2.0) * T[:, None]
    s_g = model.basis(t + T / 3.0) * (0.5 * T * T)[:, None]
    gravity = np.stack((u_g, s_g), axis=1) @ about.R.T
    u_m, s_m = model_force(epochs, first, about, gravity)
    U, S = skew(u_m), skew(s_m)
    B, BB = epochs.B[first:], epochs.BB[first:]
    eye = np.eye(3)

    F = np.zeros((K, n, n))
    F[:, PHI, PHI] = F[:, VEL, VEL] = F[:, POS, POS] = eye
    F[:, VEL, PHI], F[:, POS, PHI] = -U, -S
    F[:, POS, VEL] = T[:, None, None] * eye
    # phi drifts by -B b_g over the epoch, linearly, while F stays as it is.
    UB = U @ B
    bias = np.concatenate((-B, 0.5 * UB, UB * (T / 6.0)[:, None, None]), axis=1)

    G = np.zeros((K, n, noise.theta_size + 1))
    for j, columns in enumerate((R_EAST, R_NORTH, R_UP)):
        G[:, VEL, columns] = u_g[:, j, None, None] * eye
        G[:, POS, columns] = s_g[:, j, None, None] * eye
    G[:, :9, GYRO_BIAS] = bias
    G[:, VEL, ACCEL_BIAS], G[:, POS, ACCEL_BIAS] = -B, -BB
    G[:, VEL, DATA], G[:, POS, DATA] = epochs.u[first:], epochs.s[first:]

    if noise.calibration:
        # M f and M w, with f and w of the epoch's middle: column (i, j) is that of the bias
        # of axis i, times f_j or w_j.
        f_b = np.einsum("kji,kj->ki", B, u_m) / (T * T)[:, None]
        turn = epochs.C[first:-1].transpose(0, 2, 1) @ epochs.C[first + 1 :]
        w_b = unskew(turn) / T[:, None]
        G[:, :9, GYRO_MATRIX] = (bias[..., None] * w_b[:, None, None, :]).reshape(K, 9, 9)
        G[:, VEL, ACCEL_MATRIX] = -(B[..., None] * f_b[:, None, None, :]).reshape(K, 3, 9)
        G[:, POS, ACCEL_MATRIX] = -(BB[..., None] * f_b[:, None, None, :]).reshape(K, 3, 9)

    C = epochs.C[first + 1 :]
    H = np.zeros((K, 3, n))
    H[:, :, PHI], H[:, :, POS] = skew(C @ about.r_b), eye
    Q = np.zeros((K, n, n))
    Q[:, :9, :9] = _process_noise(T, U, noise)
    if noise.drift > 0.0:
        decay = np.exp(-T / noise.drift_time_s)
        F[:, :9, DRIFT] = bias
        F[:, DRIFT, DRIFT] = decay[:, None, None] * eye
        Q[:, DRIFT, DRIFT] = (noise.drift**2 * (1.0 - decay**2))[:, None, None] * eye
    return Steps(F, G, Q, H, C)


def _process_noise(T: Array, U: Array, noise: NoiseModel) -> Array:
    """Covariance that an epoch adds to phi, v, d: (K, 9, 9).

    White gyro noise w gives phi -W, v +[F x] int W, d +[F x] int int W with W = int w and
    F = U/T; its moments are those of a triple integrator.
    """
    T = T[:, None, None]
    eye = np.eye(3)
    M = U / T
    MMt = M @ M.transpose(0, 2, 1)
    qg, qa, qp = noise.gyro**2, noise.accel**2, noise.walk**2
    Q = np.empty((T.shape[0], 9, 9))
    Q[:, PHI, PHI] = qg * T * eye
    Q[:, VEL, PHI] = -qg * T**2 / 2.0 * M
    Q[:, POS, PHI] = -qg * T**3 / 6.0 * M
    Q[:, VEL, VEL] = qg * T**3 / 3.0 * MMt + qa * T * eye
    Q[:, POS, VEL] = qg * T**4 / 8.0 * MMt + qa * T**2 / 2.0 * eye
    Q[:, POS, POS] = qg * T**5 / 20.0 * MMt + (qa * T**3 / 3.0 + qp * T) * eye
    Q[:, PHI, VEL] = Q[:, VEL, PHI].transpose(0, 2, 1)
    Q[:, PHI, POS] = Q[:, POS, PHI].transpose(0, 2, 1)
    Q[:, VEL, POS] = Q[:, POS, VEL].transpose(0, 2, 1)
    return Q


class PositionNoise:
    """Variance of the swing centre's position at an epoch [m^2], grown by the innovations.

    Never below its floor. It grows where the innovations of the last epochs say that the
    centre is not at rest, by what they exceed their expectation.
    """

    MEMORY = 20  # epochs
    SIGNIFICANT = 1.5  # ratio of variances from which on it grows

    def __init__(self, floor: float) -> None:
        self.floor = floor
        self.variance = floor
        self._seen = self._expected = self._consistency = 0.0
        self._weight = 0.0

    def update(self, squared: float, expected: float, nis: float) -> None:
        """Take in an innovation: its square, what the floor expects, its normalised square."""
        self._weight += (1.0 - self._weight) / self.MEMORY
        share = 1.0 / self.MEMORY
        self._seen += share * (squared - self._seen)
        self._expected += share * (expected - self._expected)
        self._consistency += share * (nis / 3.0 - self._consistency)
        excess = self._seen - self._expected
        grown = self._seen > self.SIGNIFICANT * self._expected
        self.variance = self.floor + (excess / (3.0 * self._weight) if grown else 0.0)

    @property
    def consistency(self) -> float:
        """Mean normalised innovation squared over its expectation, of the last epochs."""
        return self._consistency / self._weight if self._weight else float("nan")


class TwoStageFilter:
    """Filter of the random part, with the columns of its response to theta.

    x : the random part's estimate is X[:, DATA] + X[:, :-1] theta
    P : (n, n) its covariance for given theta
    normal : (p+1, p+1) sum of E^T S^-1 E
    """

    def __init__(self, noise: NoiseModel) -> None:
        n = 12 if noise.drift > 0.0 else 9
        self.noise = PositionNoise(noise.position**2)
        self.X = np.zeros((n, noise.theta_size + 1))
        self.X[VEL, V0] = self.X[POS, LEVER] = np.eye(3)
        self.P = np.zeros((n, n))
        self.P[POS, POS] = noise.position**2 * np.eye(3)
        if noise.drift > 0.0:
            self.P[DRIFT, DRIFT] = noise.drift**2 * np.eye(3)
        self.normal = np.zeros((noise.theta_size + 1, noise.theta_size + 1))

    def run(self, steps: Steps, theta: Array | None) -> None:
        """Take in epochs. With theta (p,) the innovations are judged and may grow R."""
        whole = None if theta is None else np.append(theta, 1.0)
        X, P = self.X, self.P
        n, columns = X.shape
        whitened = np.empty((steps.F.shape[0], 3, columns))
        right = np.empty((3, columns + n), order="F")
        eye = np.eye(3)
        for k, (F, G, Q, H, C) in enumerate(zip(*steps, strict=True)):
            X = F @ X
            X += G
            P = F @ P @ F.T
            P += Q
            HP = H @ P
            S = HP @ H.T
            at_floor = S[0, 0] + S[1, 1] + S[2, 2] + 3.0 * self.noise.floor
            S += self.noise.variance * eye
            right[:, :columns] = H @ X
            right[:, LEVER] -= C
            right[:, columns:] = HP
            # With S = L L^T: L^-1 [E, H P], then X - P H^T S^-1 E and P - P H^T S^-1 H P.
            L, _ = dpotrf(S, lower=1)
            white, _ = dtrtrs(L, right, lower=1)
            E, W = white[:, :columns], white[:, columns:]
            X -= W.T @ E
            P -= W.T @ W
            whitened[k] = E
            if whole is not None:
                squared = right[:, :columns] @ whole
                normalised = E @ whole
                self.noise.update(
                    float(squared @ squared), at_floor, float(normalised @ normalised)
                )
        flat = whitened.reshape(-1, columns)
        self.normal += flat.T @ flat
        self.X, self.P = X, P
