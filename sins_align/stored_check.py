"""Whether a stored alignment is still that of the base: gravity and the Earth's rate.

The gyros turn everything into b0. With the stored attitude C as the mean one over the check,

    theta(t) = log(Exp(-w_ie t) C C_b0b(t) C^T)

is how the base seems to turn against ENU. Its slope is what is left of the measured rate when
the Earth's is taken off, and the force in the axes that turn along with it should point up.
For C = (I - [phi x]) C_true

    slope                  = w_ie x phi + b_gyro + noise
    (f_E, f_N) / |f|       = (-phi_N, phi_E) + b_accel / g + noise

five numbers, of which the stored covariance, the declared biases, the white noise and the sway
seen in the check make a covariance. The biases that the stored run had are in its covariance;
the ones of today are drawn anew. Where they have stayed the same, the sum is too large.

How long: ARW sees heading to sigma = ARW / (Omega cos L sqrt T), and the bias stands in the way
of more than sigma_b / (Omega cos L): they are equal at T = (ARW / sigma_b)^2, which is 13 s for
the grade tactical, 9 s for rlg_parked, 36 s for fog, 100 s for rlg and 225 s for fog_noisy.

What cannot be seen: a base that has been turned in heading by less than five sigma of that sum.
At 40 deg of latitude and on firm ground that is 11' for rlg, 1 deg for fog, 1.5 deg for
fog_noisy, and 40 deg for tactical, whose gyro knows no better. On a base that sways it is more.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sins_align.config import Completion
from sins_align.earth import GRAVITY_EQUATOR, earth_rate_n
from sins_align.grades import ImuGrade
from sins_align.increments import integrate_windows
from sins_align.rotation import dcm_from_quaternion, exp_rotation, log_rotation, skew3
from sins_align.stored import StoredAlignment
from sins_align.types import Array, ImuBlock, ImuSampling
from sins_align.units import ARCMIN, DEG_PER_H

CHECK_S = 30.0
WINDOWS = 10  # a block of about a second: sway of up to 5 Hz is seen
# Chi-square of 5 degrees of freedom beyond which there is one false alarm in 1e4.
CHI_SQUARE_LIMIT, DEGREES = 25.745, 5
# Sway is taken to be as slow as this; of a faster one less is left in a slope and a mean.
SWAY_RATE = 2.0 * math.pi / 10.0  # [rad/s]
# No sensors are better than this.
LEAST_RATE, LEAST_TILT = 1e-9, 1e-7  # [rad/s], [rad]

CHECKING = "checking the stored alignment ({done:.0f} of {whole:.0f} s)"
GRAVITY_DIFFERS = (
    "the stored alignment does not fit: gravity differs by {angle:.2g}' (sigma {sigma:.2g}')"
)
RATE_DIFFERS = (
    "the stored alignment does not fit: the Earth's rate differs by {rate:.2g} deg/h"
    " (sigma {sigma:.2g} deg/h)"
)
MOVES = "the base moves too much to take over the stored alignment: {sway:.2g}' rms"


class Passed(NamedTuple):
    """A stored alignment that fits.

    C_nb : (3, 3) at the end of the check
    covariance : (6, 6) in its middle, of phi (n) and of the gyro bias (b) [rad^2], [rad^2/s^2]
    gyro_bias : (3,) with which the stored attitude stays what it is [rad/s]
    chi_square : of the check
    half_s : from the middle of the check to its end
    """

    C_nb: Array
    covariance: Array
    gyro_bias: Array
    chi_square: float
    half_s: float


class _Motion(NamedTuple):
    """What the sensors saw, against the stored attitude; axes east, north, up.

    duration_s : of the check
    slope : (3,) of theta [rad/s]
    sway : (3, 3) covariance of what is left of theta [rad^2], slow_sway of its means over a second
    tilt : (2,) direction of the force, east, north [rad]; scatter : (2, 2) covariance of its
        means over a second [rad^2]
    end : (3,) theta at the end, against its mean [rad]
    """

    duration_s: float
    slope: Array
    sway: Array
    slow_sway: Array
    tilt: Array
    scatter: Array
    end: Array


class StoredCheck:
    """Gathers the first `CHECK_S` of samples and judges.

    Parameters
    ----------
    stored : the alignment to check
    grade, sampling : of the IMU
    completion : sway of the base below its thresholds, or below the stored sigma, is taken for
        part of the stored covariance: nobody knows at what phase of it the last run ended
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
        self._sampling = sampling
        self._completion = completion
        self._w_ie_n = earth_rate_n(latitude)
        self._elapsed_s = 0.0
        self._C_b0b = np.eye(3)
        self._ends_s = [0.0]
        self._turned = [np.eye(3)]  # C_b0b at the ends of the windows
        self._u: list[Array] = []  # of the windows, in b0
        self._seconds = [1]  # place in `_turned` after each block

    @property
    def elapsed_s(self) -> float:
        """How much has been seen."""
        return self._elapsed_s

    def add(self, block: ImuBlock) -> None:
        """Take in the next block."""
        windows = integrate_windows(block, self._sampling, WINDOWS)
        for duration, u, C in zip(windows.duration_s, windows.u, windows.C_end, strict=True):
            self._ends_s.append(self._ends_s[-1] + float(duration))
            self._turned.append(self._C_b0b @ C)
            self._u.append(self._C_b0b @ u)
        self._C_b0b = self._turned[-1]
        self._seconds.append(len(self._turned))
        self._elapsed_s += int(block.stamp_ns[-1] - block.stamp_ns[0]) * 1e-9

    def judge(self) -> Passed | str:
        """The alignment to go on from, or why not."""
        motion = self._motion()
        sigma = np.sqrt(self._stored.misalignment_covariance.diagonal())
        threshold = self._completion.level_threshold
        bound = np.maximum([threshold, threshold, self._completion.heading_threshold], sigma)
        sway = np.sqrt(motion.sway.diagonal())
        if not (sway <= bound).all():
            return MOVES.format(sway=sway.max() / ARCMIN)
        P = self._stored.misalignment_covariance + motion.sway
        rate_noise, tilt_noise = self._noise(motion)
        H = skew3(self._w_ie_n)
        tilt_of_phi = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0]])
        J = np.vstack((tilt_of_phi, H))
        R = J @ P @ J.T
        R[:2, :2] += tilt_noise
        R[2:, 2:] += rate_noise + self._bias_variance() * np.eye(3)
        y = np.concatenate((motion.tilt, motion.slope))
        # Radians and radians a second, brought to sigma before they meet.
        scale = 1.0 / np.sqrt(R.diagonal())
        chi_square = float((y * scale) @ np.linalg.solve(R * np.outer(scale, scale), y * scale))
        if not chi_square <= CHI_SQUARE_LIMIT:
            return _misfit(y, R)
        return self._pass(motion, P, rate_noise, chi_square)

    def _motion(self) -> _Motion:
        C, t = self._C_nb, np.array(self._ends_s)
        theta = np.array(
            [
                log_rotation(exp_rotation(-self._w_ie_n * s) @ C @ turned @ C.T)
                for s, turned in zip(t, self._turned, strict=True)
            ]
        )
        mean, centred = theta.mean(axis=0), t - t.mean()
        slope = centred @ theta / (centred @ centred)
        left = theta - mean - np.outer(centred, slope)
        edges = [(a, b) for a, b in zip(self._seconds[:-1], self._seconds[1:], strict=True)]
        slow = np.array([left[a:b].mean(axis=0) for a, b in edges])
        forces = np.array([self._force(a, b, mean, slope, t) for a, b in edges])
        lengths = np.array([t[b - 1] - t[a - 1] for a, b in edges])
        force = lengths @ forces / lengths.sum()
        tilts = forces[:, :2] / np.linalg.norm(force)
        return _Motion(
            duration_s=float(t[-1]),
            slope=slope,
            sway=left.T @ left / len(left),
            slow_sway=slow.T @ slow / len(slow),
            tilt=force[:2] / np.linalg.norm(force),
            scatter=np.cov(tilts.T),
            end=theta[-1] - mean,
        )

    def _force(self, first: int, end: int, mean: Array, slope: Array, t: Array) -> Array:
        """(3,) mean force from the windows of a block, in ENU by the stored attitude.

        The sway turns C_b0b as it turns the base, and drops out.
        """
        total = np.zeros(3)
        for k in range(first, end):
            middle = 0.5 * (t[k - 1] + t[k])
            line = mean + slope * (middle - t.mean())
            n = exp_rotation(-line) @ exp_rotation(-self._w_ie_n * middle) @ self._C_nb
            total += n @ self._u[k - 1]
        return total / (t[end - 1] - t[first - 1])

    def _bias_variance(self) -> float:
        """Of a gyro of the declared grade [rad^2/s^2]."""
        return self._grade.gyro_bias**2 + self._grade.gyro_bias_instability**2

    def _noise(self, motion: _Motion) -> tuple[Array, Array]:
        """Covariances (3, 3) of the slope, biases apart, and (2, 2) of the tilt.

        White rate: 6/5 ARW^2 / T on a slope by least squares. A sway of rms q and rate w
        leaves 12 q / (w T^2) of itself in a slope, and 2 q / (w T) in a mean.
        """
        grade, T = self._grade, motion.duration_s
        rate = motion.slow_sway * (12.0 / (SWAY_RATE * T * T)) ** 2
        rate += (1.2 * grade.gyro_arw**2 / T + LEAST_RATE**2) * np.eye(3)
        triad = math.hypot(grade.accel_scale, grade.misalignment)
        bias = (grade.accel_bias / GRAVITY_EQUATOR) ** 2 + triad**2
        white = (grade.accel_vrw / GRAVITY_EQUATOR) ** 2 / T
        tilt = motion.scatter * (2.0 / (SWAY_RATE * T)) ** 2
        tilt += (bias + white + LEAST_TILT**2) * np.eye(2)
        return rate, tilt

    def _pass(self, motion: _Motion, P: Array, rate_noise: Array, chi_square: float) -> Passed:
        """Gyro bias from the slope; phi is left alone, and considered in its covariance.

        z = b + H phi + n, K = S (S + H P H^T + N)^-1 in body axes. The heading error and the
        bias of the stored run are one error, so that a heading improved by the slope would
        claim what nobody knows. The bias that comes out is the one that keeps the attitude.
        """
        C, S = self._C_nb, self._bias_variance() * np.eye(3)
        H, N = C.T @ skew3(self._w_ie_n), C.T @ rate_noise @ C
        K = np.linalg.solve(S + H @ P @ H.T + N, S).T
        left = np.eye(3) - K
        covariance = np.zeros((6, 6))
        covariance[:3, :3] = P
        covariance[3:, :3] = -K @ H @ P
        covariance[:3, 3:] = covariance[3:, :3].T
        covariance[3:, 3:] = left @ S @ left.T + K @ (H @ P @ H.T + N) @ K.T
        gyro_bias = K @ C.T @ motion.slope
        half_s = 0.5 * motion.duration_s
        # The mean attitude is that of the middle, from which the bias found is a drift.
        C_nb = exp_rotation(motion.end - C @ gyro_bias * half_s) @ C
        return Passed(C_nb, covariance, gyro_bias, chi_square, half_s)


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
