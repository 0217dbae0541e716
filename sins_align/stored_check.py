"""Whether a stored alignment is still that of the base: gravity and the Earth's rate.

With the stored attitude C = (I - [phi x]) C_true as the mean one over the check, `stored_motion`
gives the rate at which the gyros drift off, and the direction of the force:

    drift                  = w_ie x phi + b_gyro + noise
    (f_E, f_N) / |f|       = (-phi_N, phi_E) + b_accel / g + noise

five numbers, of which the stored covariance, the declared biases, the white noise and the sway
seen in the check make a covariance. The biases that the stored run had are in its covariance;
the ones of today are drawn anew. Where they have stayed the same, the sum is too large.

How long: ARW sees heading to sigma = ARW / (Omega cos L sqrt T), and the bias stands in the way
of more than sigma_b / (Omega cos L): they are equal at T = (ARW / sigma_b)^2, which is 13 s for
the grade tactical, 9 s for rlg_parked, 36 s for fog, 100 s for rlg and 225 s for fog_noisy.

A base that sways has been left at some phase of its sway. Heading is taken from the file all the
same, with the sway of heading in its covariance; the levels are those of the check, where they
are the better ones. Where the Earth's rate is not seen well enough, `sees_heading` is false, and
whoever is to believe the heading needs a witness.

What cannot be seen: a base that has been turned in heading by less than five sigma of that sum.
At 40 deg of latitude and on firm ground that is 11' for rlg, 1 deg for fog, 1.5 deg for
fog_noisy, and 40 deg for tactical, whose gyro knows no better. On a base that sways it is more, but
no more than that or five times `HEADING_SIGMA`, where the witness takes over.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sins_align.config import Completion
from sins_align.earth import GRAVITY_EQUATOR, earth_rate_n
from sins_align.grades import ImuGrade
from sins_align.rotation import dcm_from_quaternion, exp_rotation, skew3
from sins_align.stored import StoredAlignment
from sins_align.stored_motion import TILT_BY_TURN, Motion, MotionRecord
from sins_align.types import Array, ImuBlock, ImuSampling
from sins_align.units import ARCMIN, DEG_PER_H

CHECK_S = 30.0
# Chi-square of 5 degrees of freedom beyond which there is one false alarm in 1e4.
CHI_SQUARE_LIMIT, DEGREES = 25.745, 5
# What is to be seen of heading: this, or twice what the gyro sees on firm ground [rad].
HEADING_SIGMA = math.radians(0.5)
# Larger tilts and heading are no longer apart: the product of two is 0.3'.
GREATEST_TILT = math.radians(0.5)
# No sensors are better than this.
LEAST_RATE, LEAST_TILT = 1e-9, 1e-7  # [rad/s], [rad]

GRAVITY_DIFFERS = "gravity differs by {angle:.2g}' (sigma {sigma:.2g}')"
RATE_DIFFERS = "the Earth's rate differs by {rate:.2g} deg/h (sigma {sigma:.2g} deg/h)"
MOVES = "the base moves too much: {sway:.2g}' rms"


class Passed(NamedTuple):
    """A stored alignment that fits.

    C_nb : (3, 3) at the end of the check
    covariance : (6, 6) in its middle, of phi (n) and of the gyro bias (b) [rad^2], [rad^2/s^2]
    gyro_bias : (3,) with which the stored attitude stays what it is [rad/s]
    chi_square : of the check
    half_s : from the middle of the check to its end
    sees_heading : whether the Earth's rate tells that heading is right
    """

    C_nb: Array
    covariance: Array
    gyro_bias: Array
    chi_square: float
    half_s: float
    sees_heading: bool


class StoredCheck:
    """Gathers the first `CHECK_S` of samples and judges.

    Parameters
    ----------
    stored : the alignment to check
    grade, sampling : of the IMU
    completion : sway of heading below its threshold, or below the stored sigma, is taken for part
        of the stored covariance: nobody knows at what phase of it the last run ended
    latitude : [rad]
    """

    def __init__(
        self,
        stored: StoredAlignment,
        grade: ImuGrade,
        sampling: ImuSampling,
        completion: Completion,
        latitude: float,
    ) -> None:
        self._stored = stored
        self._C_nb = dcm_from_quaternion(stored.q_nb)
        self._grade = grade
        self._completion = completion
        self._w_ie_n = earth_rate_n(latitude)
        self._record = MotionRecord(sampling)

    @property
    def elapsed_s(self) -> float:
        """How much has been seen."""
        return self._record.elapsed_s

    @property
    def heading_sigma(self) -> float:
        """As stored [rad]."""
        return math.sqrt(float(self._stored.misalignment_covariance[2, 2]))

    @property
    def is_enough(self) -> bool:
        """Whether an alignment as it is stored would be complete."""
        return self.heading_sigma < self._completion.heading_threshold

    def add(self, block: ImuBlock) -> None:
        """Take in the next block."""
        self._record.add(block)

    def judge(self) -> Passed | str:
        """The alignment to go on from, or why not."""
        motion = self._record.motion(self._C_nb, self._w_ie_n)
        heading = max(self._completion.heading_threshold, self.heading_sigma)
        sway = np.sqrt(motion.sway.diagonal())
        if not (sway <= [GREATEST_TILT, GREATEST_TILT, heading]).all():
            return MOVES.format(sway=sway.max() / ARCMIN)
        P = self._stored.misalignment_covariance + motion.sway
        rate_noise, tilt_noise = self._noise(motion)
        H = skew3(self._w_ie_n)
        J = np.vstack((TILT_BY_TURN, H))
        R = J @ P @ J.T
        R[:2, :2] += tilt_noise
        R[2:, 2:] += rate_noise + self._bias_variance() * np.eye(3)
        y = np.concatenate((motion.tilt, motion.drift))
        # Radians and radians a second, brought to sigma before they meet.
        scale = 1.0 / np.sqrt(R.diagonal())
        chi_square = float((y * scale) @ np.linalg.solve(R * np.outer(scale, scale), y * scale))
        if not chi_square <= CHI_SQUARE_LIMIT:
            return _misfit(y, R)
        C_nb, P = self._level(motion, P, tilt_noise)
        passed = self._pass(motion, C_nb, P, rate_noise)
        return passed._replace(chi_square=chi_square, sees_heading=self._sees(motion, R[2, 2]))

    def _sees(self, motion: Motion, variance: float) -> bool:
        """Whether the rate about east, of that variance, tells enough of heading."""
        firm = 1.2 * self._grade.gyro_arw**2 / motion.duration_s + 2.0 * self._bias_variance()
        least = HEADING_SIGMA * float(self._w_ie_n[1])
        return variance <= max(least**2, 4.0 * firm)

    def _level(self, motion: Motion, P: Array, tilt_noise: Array) -> tuple[Array, Array]:
        """C_nb and covariance of phi with the better levels: the stored ones, or the force's.

        The two share the accelerometers' biases and are not averaged.
        """
        if tilt_noise.trace() >= P[0, 0] + P[1, 1]:
            return self._C_nb, P
        phi = TILT_BY_TURN.T @ motion.tilt
        levelled = TILT_BY_TURN.T @ tilt_noise @ TILT_BY_TURN
        levelled[2, 2] = P[2, 2]
        return exp_rotation(phi) @ self._C_nb, levelled

    def _bias_variance(self) -> float:
        """Of a gyro of the declared grade [rad^2/s^2]."""
        return self._grade.gyro_bias**2 + self._grade.gyro_bias_instability**2

    def _noise(self, motion: Motion) -> tuple[Array, Array]:
        """Covariances (3, 3) of the drift, biases apart, and (2, 2) of the tilt.

        White rate leaves 6/5 ARW^2 / T in a slope by least squares.
        """
        grade, T = self._grade, motion.duration_s
        rate = motion.drift_noise + (1.2 * grade.gyro_arw**2 / T + LEAST_RATE**2) * np.eye(3)
        triad = math.hypot(grade.accel_scale, grade.misalignment)
        bias = (grade.accel_bias / GRAVITY_EQUATOR) ** 2 + triad**2
        white = (grade.accel_vrw / GRAVITY_EQUATOR) ** 2 / T
        tilt = motion.tilt_noise + (bias + white + LEAST_TILT**2) * np.eye(2)
        return rate, tilt

    def _pass(self, motion: Motion, C: Array, P: Array, rate_noise: Array) -> Passed:
        """Gyro bias from the drift; phi is left alone, and considered in its covariance.

        z = b + H phi + n, K = S (S + H P H^T + N)^-1 in body axes. The heading error and the
        bias of the stored run are one error, so that a heading improved by the drift would
        claim what nobody knows. The bias that comes out is the one that keeps the attitude.
        """
        S = self._bias_variance() * np.eye(3)
        H, N = C.T @ skew3(self._w_ie_n), C.T @ rate_noise @ C
        K = np.linalg.solve(S + H @ P @ H.T + N, S).T
        left = np.eye(3) - K
        covariance = np.zeros((6, 6))
        covariance[:3, :3] = P
        covariance[3:, :3] = -K @ H @ P
        covariance[:3, 3:] = covariance[3:, :3].T
        covariance[3:, 3:] = left @ S @ left.T + K @ (H @ P @ H.T + N) @ K.T
        gyro_bias = K @ C.T @ motion.drift
        half_s = 0.5 * motion.duration_s
        # The mean attitude is that of the middle, from which the bias found is a drift.
        C_nb = exp_rotation(motion.end - C @ gyro_bias * half_s) @ C
        return Passed(C_nb, covariance, gyro_bias, math.nan, half_s, sees_heading=False)


def _misfit(y: Array, R: Array) -> str:
    """Which of gravity (2) and the Earth's rate (3) is further off."""
    tilt, rate = y[:2], y[2:]
    of_tilt = float(tilt @ np.linalg.solve(R[:2, :2], tilt))
    of_rate = float(rate @ np.linalg.solve(R[2:, 2:], rate))
    sigma = np.sqrt(R.diagonal())
    if of_tilt / 2.0 > of_rate / 3.0:
        return GRAVITY_DIFFERS.format(
            angle=float(np.linalg.norm(tilt)) / ARCMIN, sigma=sigma[:2].max() / ARCMIN
        )
    return RATE_DIFFERS.format(
        rate=float(np.linalg.norm(rate)) / DEG_PER_H, sigma=sigma[2:].max() / DEG_PER_H
    )
