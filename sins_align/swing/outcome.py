"""From a solution to what is given out: attitude at a time, with everything's covariance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sins_align.rotation import exp_rotation, quaternion_from_dcm
from sins_align.swing.checks import Report
from sins_align.swing.excitation import LeverDirections
from sins_align.swing.solution import KAPPA, X_BA, X_BG, X_R, Solution
from sins_align.swing.two_stage import DATA, DRIFT, GYRO_BIAS, PHI, NoiseModel
from sins_align.swing.two_stage_filter import TwoStageFilter
from sins_align.types import Array, Estimate, LeverArm

# A lever arm is told when so much of the prior variance is left at most, or this sigma [m].
TOLD_SHARE, KNOWN_LEVER = 0.5, 0.05


@dataclass(frozen=True)
class Outcome:
    """A solution, with the filter at the last epoch.

    report : what speaks for it
    lever, lever_sigma : directions of the lever arm that the motion tells, and its prior [m]
    earth_rate_n : (3,) w_ie, ENU [rad/s]
    time_s : of the last epoch, from the first sample on [s]
    """

    solution: Solution
    filter: TwoStageFilter
    noise: NoiseModel
    report: Report
    lever: LeverDirections
    lever_sigma: float
    earth_rate_n: Array
    time_s: float

    def estimate(self, stamp_ns: int, C_b0b: Array, ahead_s: float) -> Estimate:
        """At a time, `ahead_s` after the last epoch; C_b0b by the raw gyros.

        C_nb = Exp(-w_ie t) R^T (I + [phi x]) C^
        """
        solution, filter_, report = self.solution, self.filter, self.report
        theta = solution.theta
        x = filter_.X[:, :DATA] @ theta + filter_.X[:, DATA]
        bias = theta[GYRO_BIAS] + (x[DRIFT] if self.noise.drift > 0.0 else 0.0)
        # The random part is that of the last cycle; since then the bias has gone on.
        phi = x[PHI] - C_b0b @ bias * ahead_s
        C_nb0 = C_nb0_at(self.time_s + ahead_s, self.earth_rate_n, solution)
        P = phi_covariance(filter_, solution.jacobian, solution.covariance)
        P += self.noise.gyro**2 * ahead_s * np.eye(3)
        P_n = C_nb0 @ P @ C_nb0.T
        if report.moved is not None:
            P_n += np.outer(report.moved, report.moved)
        return Estimate(
            stamp_ns=stamp_ns,
            q_nb=quaternion_from_dcm(C_nb0 @ exp_rotation(phi) @ C_b0b),
            misalignment_covariance=0.5 * (P_n + P_n.T),
            gyro_bias=bias,
            gyro_bias_sigma=self._gyro_bias_sigma(),
            accel_bias=solution.x[X_BA],
            accel_bias_sigma=np.sqrt(solution.covariance.diagonal()[X_BA]),
            lever_arm=self._lever_arm(),
            consistency=filter_.noise.consistency,
            witness=report.witness,
            steadiness=report.steadiness,
            latitude=report.latitude,
        )

    def _gyro_bias_sigma(self) -> Array:
        """(3,) of the constant part and the drift."""
        solution, filter_ = self.solution, self.filter
        response = np.zeros((3, solution.x.shape[0]))
        response[:, X_BG] = np.eye(3)
        variance = np.zeros(3)
        if self.noise.drift > 0.0:
            response += filter_.X[DRIFT, :DATA] @ solution.jacobian
            variance = filter_.P[DRIFT, DRIFT].diagonal()
        return np.sqrt(variance + (response @ solution.covariance @ response.T).diagonal())

    def _lever_arm(self) -> LeverArm:
        solution, (free, considered) = self.solution, self.lever
        prior = self.lever_sigma**2
        # What is considered is in the solution's covariance; the rest is the prior.
        unknown = np.eye(3) - free @ free.T - considered @ considered.T
        covariance = solution.covariance[X_R, X_R] + prior * unknown
        told = max(TOLD_SHARE * prior, KNOWN_LEVER**2)
        x, y, z = (bool(variance <= told) for variance in covariance.diagonal())
        return LeverArm(solution.x[X_R].copy(), covariance, (x, y, z))


def C_nb0_at(time_s: float, earth_rate_n: Array, solution: Solution) -> Array:
    """(3, 3) b0 -> n: the Earth has turned."""
    return exp_rotation(-earth_rate_n * time_s) @ solution.R.T


def heading_variance(solution: Solution) -> float:
    """Of the attitude at the first sample [rad^2]."""
    up = solution.R[:, 2]
    return float(up @ solution.covariance[KAPPA, KAPPA] @ up)


def phi_covariance(filter_: TwoStageFilter, jacobian: Array, covariance: Array) -> Array:
    """(3, 3) of the attitude's error in b0: the filter's own, its response to x, and kappa.

    jacobian : (p, m) d theta / d x; covariance : (m, m) of x
    """
    response = filter_.X[PHI, :DATA] @ jacobian
    response[:, KAPPA] -= np.eye(3)
    P: Array = filter_.P[PHI, PHI] + response @ covariance @ response.T
    return P
