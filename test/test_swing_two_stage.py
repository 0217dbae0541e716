"""Every block of the two-stage filter against a non-linear propagation of its own."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from sins_align.earth import EARTH_RATE, normal_gravity
from sins_align.rotation import exp_rotation, skew
from sins_align.simulate import SwingOptions, simulate_swing
from sins_align.swing.epochs import Epochs
from sins_align.swing.two_stage import (
    ACCEL_BIAS,
    ACCEL_MATRIX,
    GYRO_BIAS,
    GYRO_MATRIX,
    LEVER,
    PHI,
    POS,
    R_UP,
    V0,
    VEL,
    GravityModel,
    Linearisation,
    NoiseModel,
    build_steps,
)
from sins_align.swing.two_stage_filter import TwoStageFilter
from sins_align.types import Array, ImuBlock, ImuSampling
from sins_align.windows import integrate_windows

LATITUDE = np.radians(40.0)
GRAVITY = GravityModel(normal_gravity(LATITUDE, 50.0), LATITUDE, EARTH_RATE)
NOISE = NoiseModel(
    gyro=1e-5, accel=1e-3, drift=0.0, drift_time_s=300.0, position=1e-3, walk=1e-4,
    calibration=True,
)  # fmt: skip


class Swing:
    """Thirty seconds of the paper's large pitch, without any error."""

    def __init__(self) -> None:
        run = simulate_swing(SwingOptions(grade="perfect", rate_hz=100.0, duration_s=30.0, seed=3))
        self.block = ImuBlock(*run.imu)
        C_nb = run.truth.C_nb_at(int(run.imu.stamp_ns[0]))
        self.R = C_nb.T
        self.r_b = np.asarray(run.truth.lever_arm_m)
        self.theta = np.zeros(39)
        self.theta[:9] = self.R.T.reshape(9)
        w0 = run.imu.w_ib_b[:, 0]
        self.theta[V0], self.theta[LEVER] = np.cross(w0, self.r_b), self.r_b
        self.epochs = self._epochs(self.block)
        about = Linearisation(self.R, self.r_b)
        self.steps = build_steps(self.epochs, 0, about, GRAVITY, NOISE)

    @staticmethod
    def _epochs(block: ImuBlock) -> Epochs:
        epochs = Epochs()
        epochs.append(integrate_windows(block, ImuSampling.INSTANTANEOUS, 60))
        return epochs

    def observed(self, theta: Array) -> Array:
        """d - C r at the epochs, non-linear in theta: (60, 3)."""
        M_g, M_a = theta[GYRO_MATRIX].reshape(3, 3), theta[ACCEL_MATRIX].reshape(3, 3)
        w = self.block.w_ib_b - M_g @ self.block.w_ib_b - theta[GYRO_BIAS, None]
        f = self.block.f_ib_b - M_a @ self.block.f_ib_b - theta[ACCEL_BIAS, None]
        epochs = self._epochs(ImuBlock(self.block.stamp_ns, w, f))
        R = theta[:9].reshape(3, 3).T
        d, v, out = theta[LEVER].copy(), theta[V0].copy(), []
        t = epochs.time_s
        for k, T in enumerate(epochs.duration_s):
            # Gravity by Gauss-Legendre, not by the filter's linear rule.
            x, weight = np.polynomial.legendre.leggauss(4)
            tau = 0.5 * T * (x + 1.0)
            g = GRAVITY.basis(t[k] + tau) @ R.T
            d = d + v * T + epochs.s[k] + 0.5 * T * ((weight * (T - tau)) @ g)
            v = v + epochs.u[k] + 0.5 * T * (weight @ g)
            out.append(d - epochs.C[k + 1] @ theta[LEVER])
        return np.array(out)

    def response(self) -> Array:
        """H X of the filter's columns without any update: (60, 3, 40)."""
        X = TwoStageFilter(NOISE).X.copy()
        out = []
        width = X.shape[1]
        for F, added, H, observed in zip(*self.steps, strict=True):
            X = F @ X + added[:, :width]
            out.append(H @ X + observed[:, :width])
        return np.array(out)


@pytest.fixture(scope="module")
def swing() -> Swing:
    return Swing()


def test_truth_fulfils_the_equations(swing: Swing) -> None:
    """The simulator and the filter derive the same physics, each for itself."""
    assert np.abs(swing.observed(swing.theta)).max() < 1e-6
    whole = swing.response() @ np.append(swing.theta, 1.0)
    assert np.abs(whole).max() < 1e-6


# Step of the parameter, and how far the straight lines within an epoch may be off: gravity as
# linear (R_n acts by its square), the model's force as constant, the drift as linear.
CASES = [
    ("attitude", range(9), 1e-3, 3e-4),
    ("start velocity", range(9, 12), 1e-2, 1e-9),
    ("lever arm", range(12, 15), 1e-2, 1e-9),
    ("gyro bias", range(15, 18), 1e-6, 5e-3),
    ("accelerometer bias", range(18, 21), 1e-4, 1e-6),
    ("gyro matrix", range(21, 30), 1e-5, 5e-2),
    ("accelerometer matrix", range(30, 39), 1e-5, 5e-3),
]


@pytest.mark.parametrize(("name", "columns", "step", "tolerance"), CASES)
def test_response_is_the_derivative(
    swing: Swing, name: str, columns: range, step: float, tolerance: float
) -> None:
    response = swing.response()
    for column in columns:
        theta_plus, theta_minus = swing.theta.copy(), swing.theta.copy()
        theta_plus[column] += step
        theta_minus[column] -= step
        numeric = (swing.observed(theta_plus) - swing.observed(theta_minus)) / (2.0 * step)
        error = np.abs(numeric - response[:, :, column]).max() / np.abs(numeric).max()
        assert error < tolerance, f"{name}, column {column}: {error:.2e}"


def test_transition_of_phi_is_the_derivative(swing: Swing) -> None:
    """An attitude error at the start of an epoch: v and d at its end, and the observation."""
    k, step = 20, 1e-6
    F, _, H, _ = (a[k] for a in swing.steps)
    epochs = swing.epochs
    T, C = epochs.duration_s[k], epochs.C[k + 1]
    for axis in range(3):
        turned = exp_rotation(step * np.eye(3)[axis]) - np.eye(3)
        # C = Exp(phi) C^ turns the integrals of C f; the model's have the swing's share by
        # differences over an epoch.
        dv, dd = turned @ epochs.u[k] / step, turned @ epochs.s[k] / step
        scale = np.linalg.norm(epochs.u[k])
        assert np.abs(F[VEL, axis] - dv).max() < 1e-3 * scale
        assert np.abs(F[POS, axis] - dd).max() < 1e-3 * scale * T
        dz = -(turned @ C @ swing.r_b) / step
        assert np.abs(H[:, axis] - dz).max() < 1e-5 * np.linalg.norm(swing.r_b)


def test_process_noise_is_the_integral(swing: Swing) -> None:
    """Q of an epoch against Van Loan's matrix exponential with the epoch's mean force."""
    k = 20
    width = NOISE.theta_size + 1
    F, added, _, _ = (a[k] for a in swing.steps)
    Q, T = added[:, width:], swing.epochs.duration_s[k]
    A = np.zeros((9, 9))
    A[VEL, PHI], A[POS, VEL] = F[VEL, PHI] / T, np.eye(3)
    density = np.repeat((NOISE.gyro**2, NOISE.accel**2, NOISE.walk**2), 3)
    loan = np.zeros((18, 18))
    loan[:9, :9], loan[:9, 9:], loan[9:, 9:] = -A, np.diag(density), A.T
    exponential = expm(loan * T)
    expected = exponential[9:, 9:].T @ exponential[:9, 9:]
    scale = np.sqrt(np.outer(expected.diagonal(), expected.diagonal()))
    assert np.abs((Q - expected) / scale).max() < 1e-6


def test_gravity_turns_with_the_earth() -> None:
    """The basis in R_e, R_n, R_u against the rotation of n0 by the Earth."""
    w_ie_n = EARTH_RATE * np.array([0.0, np.cos(LATITUDE), np.sin(LATITUDE)])
    for t in (0.0, 1.0, 500.0, 20_000.0):
        g_n0 = exp_rotation(w_ie_n * t) @ np.array([0.0, 0.0, -GRAVITY.magnitude])
        assert np.abs(GRAVITY.basis(np.array([t]))[0] - g_n0).max() < 1e-9


def test_free_vectors_and_rotation_agree() -> None:
    """d theta / d kappa: R = Exp(kappa) R^, column by column."""
    R = exp_rotation(np.array([0.3, -0.5, 1.2]))
    for j in range(3):
        analytic = -skew(R[:, j])
        for axis in range(3):
            step = 1e-6 * np.eye(3)[axis]
            numeric = (exp_rotation(step) @ R - exp_rotation(-step) @ R)[:, j] / 2e-6
            assert np.abs(analytic[:, axis] - numeric).max() < 1e-9


def test_covariance_stays_symmetric_and_positive(swing: Swing) -> None:
    filter_ = TwoStageFilter(NOISE)
    filter_.run(swing.steps, swing.theta)
    assert np.array_equal(filter_.P, filter_.P.T)
    assert np.linalg.eigvalsh(filter_.P).min() > 0.0
    assert filter_.X[:, R_UP].shape == (9, 3)
