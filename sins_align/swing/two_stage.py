"""The model behind the inertial-frame method, for a filter in two stages.

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

    def integral(self, time_s: Array) -> Array:
        """Integrals of the factors from 0 on: (N, 3) [m/s]."""
        c, s = np.cos(self.latitude), np.sin(self.latitude)
        angle = self.earth_rate * time_s
        # t - sin(W t) / W by its series: the difference would lose digits.
        versine = angle * angle * time_s / 6.0 * (1.0 - angle * angle / 20.0)
        return -self.magnitude * np.stack(
            (c * 0.5 * angle * time_s * np.sinc(0.5 * angle / np.pi) ** 2, s * c * versine,
             time_s - c * c * versine), axis=-1
        )  # fmt: skip


class Linearisation(NamedTuple):
    """About what the noise model is linearised.

    R : (3, 3) columns east, north, up in b0; r_b : (3,) lever arm
    """

    R: Array
    r_b: Array


class Steps(NamedTuple):
    """Epochs as the filter takes them, one a row; X and P stand side by side: [X, P].

    F : (K, n, n) transition
    added : (K, n, p + 1 + n) what an epoch adds to [X, P]: response to theta, process noise
    H : (K, 3, n) observation
    observed : (K, 3, p + 1 + n) what is added to H [X, P]: -C r
    """

    F: Array
    added: Array
    H: Array
    observed: Array


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
    v = _central_difference(d, t)
    d, v = d[first - start :], v[first - start :]
    T = epochs.duration_s[first:, None]
    u_m = v[1:] - v[:-1] - gravity[:, 0]
    s_m = d[1:] - d[:-1] - v[:-1] * T - gravity[:, 1]
    return u_m, s_m


def _central_difference(d: Array, t: Array) -> Array:
    """Time derivative of d (N, 3) at t (N,): over both neighbours, at the ends over two steps.

    Zero where there are fewer than three nodes: the swing's share of F is not known yet.
    """
    v = np.zeros_like(d)
    if t.shape[0] > 2:
        slope = (d[1:] - d[:-1]) / (t[1:] - t[:-1])[:, None]
        before, after = np.diff(t)[:-1, None], np.diff(t)[1:, None]
        v[1:-1] = (after * slope[:-1] + before * slope[1:]) / (before + after)
        v[0], v[-1] = 1.5 * slope[0] - 0.5 * slope[1], 1.5 * slope[-1] - 0.5 * slope[-2]
    return v


def build_steps(
    epochs: Epochs, first: int, about: Linearisation, model: GravityModel, noise: NoiseModel
) -> Steps:
    """The steps of all epochs from `first` on, as arrays."""
    T = epochs.duration_s[first:]
    t = epochs.time_s[first:-1]
    K, n = T.shape[0], 12 if noise.drift > 0.0 else 9
    # Gravity is as good as linear within an epoch: exact moments of a linear function.
    basis = model.basis(np.concatenate((t + T / 2.0, t + T / 3.0)))
    u_g, s_g = basis[:K] * T[:, None], basis[K:] * (0.5 * T * T)[:, None]
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

    width = noise.theta_size + 1
    added = np.zeros((K, n, width + n))
    G, Q = added[:, :, :width], added[:, :, width:]
    for j, columns in enumerate((R_EAST, R_NORTH, R_UP)):
        G[:, VEL, columns] = u_g[:, j, None, None] * eye
        G[:, POS, columns] = s_g[:, j, None, None] * eye
    G[:, :9, GYRO_BIAS] = bias
    G[:, VEL, ACCEL_BIAS], G[:, POS, ACCEL_BIAS] = -B, -BB
    G[:, VEL, DATA], G[:, POS, DATA] = epochs.u[first:], epochs.s[first:]

    if noise.calibration:
        turn = epochs.C[first:-1].transpose(0, 2, 1) @ epochs.C[first + 1 :]
        _calibrate(G, bias, B, BB, np.einsum("kji,kj->ki", B, u_m), unskew(turn), T)

    C = epochs.C[first + 1 :]
    H = np.zeros((K, 3, n))
    H[:, :, PHI], H[:, :, POS] = skew(C @ about.r_b), eye
    observed = np.zeros((K, 3, width + n))
    observed[:, :, LEVER] = -C
    Q[:, :9, :9] = _process_noise(T, U, noise)
    if noise.drift > 0.0:
        decay = np.exp(-T / noise.drift_time_s)
        F[:, :9, DRIFT] = bias
        F[:, DRIFT, DRIFT] = decay[:, None, None] * eye
        Q[:, DRIFT, DRIFT] = (noise.drift**2 * (1.0 - decay**2))[:, None, None] * eye
    return Steps(F, added, H, observed)


def _calibrate(
    G: Array, bias: Array, B: Array, BB: Array, force: Array, turn: Array, T: Array
) -> None:
    """Write the columns of M_g and M_a into G.

    M f and M w, with f and w of the epoch's middle: column (i, j) is that of the bias of axis i,
    times f_j or w_j. bias : (K, 9, 3) that of the gyros; force : (K, 3) T^2 f; turn : (K, 3) T w
    """
    K, f_b, w_b = T.shape[0], force / (T * T)[:, None], turn / T[:, None]
    G[:, :9, GYRO_MATRIX] = (bias[..., None] * w_b[:, None, None, :]).reshape(K, 9, 9)
    G[:, VEL, ACCEL_MATRIX] = -(B[..., None] * f_b[:, None, None, :]).reshape(K, 3, 9)
    G[:, POS, ACCEL_MATRIX] = -(BB[..., None] * f_b[:, None, None, :]).reshape(K, 3, 9)


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
