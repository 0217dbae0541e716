"""Coarse alignment of a moving vehicle in inertial axes: from any attitude, standing or moving.

In b0 axes, with C the rotation from b to b0 by the raw gyros, the velocity v against the Earth
and the displacement d over an epoch obey (derivatives in inertial axes)

    v' = F + F x psi - C b_a - g up(t) - g D / R_E - w x v         psi' = C b_g
    d  = (M + tau M')(f + m) - (C_end - C) l + d x psi + noise

F = C f_ib is the measured specific force, psi the gyros' drift, D the way since the start
(gravity turns with it), w the Earth rate, R_E the Earth's radius; M = int C dS is what the
odometer gives, M' = int C dv, f the vehicle's forward axis in b, m its mounting and scale
error, tau the latency, l the lever arm; sideslip and the pitch of the suspension move f
further, in proportion to the acceleration. Up and w are R = C_b0n0 times known vectors, so
that all of it is linear in

    z = [R_e, R_n, R_u, b_g, b_a, m, tau, l, gradients, 1],     R_e, R_n, R_u columns of R

Nothing has to be linearised about an attitude. What is random runs through a filter from which
z has been split off (Friedland): its innovations E z whiten the problem, and their sums
E^T S^-1 E are all that is kept. The attitude is the rotation that makes z^T (sums) z plus the
priors of the rest smallest. With vectors alone, equal weights and nothing else unknown that is
Davenport's problem, of vectors that are not normalised.

How the noise enters:

    white noise of the accelerometers   random walk of v
    white noise of the gyros            turns gravity: an acceleration that walks
    odometer, constant part             of the position at the ends: cancels in the sum
    odometer, direction and what grows  random walk of the position; a slow error counts as the
      with the way                      white noise of the same density at low frequency
    biases, mounting, scale, latency,   unknowns with a prior
      lever arm, gradients
    gyro scale error, misalignment      added to the covariance

The velocity at the start is unknown. Where the odometer is silent the inertial velocity bridges
the gap; where it contradicts, the displacement of the epoch counts for little.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sins_align.config import OdometerConfig
from sins_align.earth import earth_rate_n, normal_gravity, radii_of_curvature, transport_rate_n
from sins_align.grades import ImuGrade
from sins_align.odo.coarse_odometer import CoarseOdometer
from sins_align.odo.coarse_solution import (
    ACCEL_BIAS,
    ATTITUDE,
    DATA,
    GYRO_BIAS,
    SIZE,
    Solution,
    solve_sums,
)
from sins_align.odo.coarse_transition import transition
from sins_align.odo.epoch import AidedEpoch, Travel
from sins_align.rotation import exp_rotation, skew3
from sins_align.types import Array, Position

# Rows of the filter: position by the IMU minus that by the odometer, velocity, acceleration.
POSITION, VELOCITY, WALK = slice(0, 3), slice(3, 6), slice(6, 9)

UNIT = np.eye(3)
SPEED_SIGMA = 100.0  # of the velocity at the start [m/s]
LEAST_NOISE = 1e-9  # [m/s/sqrt(s)] for sensors that claim to have none
LEAST_EPOCHS = 3  # that make an attitude
# Innovations are judged by a solution that is renewed each time there are so many more epochs.
JUDGED_EPOCHS, JUDGED_SHARE = 5, 1.4
# Of the normalised innovation squared, three degrees of freedom: 99 % are below 11.3, but the
# prediction is linear in a heading that may be far out.
IMPLAUSIBLE = 20.0
# After so many epochs in a row it is what came before that is wrong: begin anew.
MOST_REFUSED = 40


class CoarseAttitude(NamedTuple):
    """The attitude at the end of the last epoch, and at the start of the first.

    C_nb, C_n0b0 : (3, 3)
    covariance : (3, 3) of phi, the misalignment of C_nb, axes east, north, up [rad^2]
    """

    stamp_ns: int
    C_nb: Array
    C_n0b0: Array
    covariance: Array


class CoarseAligner:
    """Sums up epochs and solves the sums when asked.

    Memory does not grow; work only by a solution that judges the innovations and is renewed
    ever more seldom.

    Parameters
    ----------
    position : latitude and altitude give Earth rate and gravity
    grade, odometer : what is declared of the sensors
    """

    def __init__(self, position: Position, grade: ImuGrade, odometer: OdometerConfig) -> None:
        self._position, self._grade = position, grade
        self._odometer = CoarseOdometer(odometer)
        self._w_n = earth_rate_n(position.latitude)
        self._gravity = g = normal_gravity(position.latitude, position.altitude)
        self._radius = float(np.mean(radii_of_curvature(position.latitude))) + position.altitude
        self._gyro_sigma = math.hypot(grade.gyro_bias, grade.gyro_bias_instability)
        calibration = g * math.hypot(grade.accel_scale, grade.misalignment)
        self._accel_sigma = math.hypot(grade.accel_bias, calibration)
        self._noise = max(grade.accel_vrw, LEAST_NOISE), g * grade.gyro_arw
        self._stamp_ns, self._time_s = 0, 0.0
        self._C, self._BC = np.eye(3), np.zeros((3, 3))  # C and int C dt at the end
        self._turned, self._angle = np.zeros(3), 0.0  # sums of the turns, and of their angles
        self._way, self._speed = np.zeros(3), 0.0  # D [m], forward speed of late [m/s]
        self._restart()

    @property
    def quantum(self) -> float:
        """Distance of one count of the odometer, as far as known [m]."""
        return self._odometer.quantum

    @quantum.setter
    def quantum(self, value: float) -> None:
        """For the epochs that follow."""
        self._odometer.quantum = value

    def _restart(self) -> None:
        self._X = np.zeros((9, SIZE))
        self._P = np.diag(np.repeat([0.0, SPEED_SIGMA**2, 0.0], 3))
        self._P[POSITION, POSITION] = self._odometer.start_noise(self._C)
        self._sums = np.zeros((SIZE, SIZE))
        self._epochs, self._refused = 0, 0
        self._judge: Solution | None = None
        self._next_judge = JUDGED_EPOCHS

    def add(self, epoch: AidedEpoch, standing: bool = False) -> None:
        """Take in the next epoch; where the vehicle stands, no odometer is needed."""
        T, C = epoch.duration_s, self._C
        travel = None if standing else epoch.travel
        if travel is not None:
            self._speed = travel.distance / T
        elif standing:
            self._speed = 0.0
        d = C @ (epoch.B @ self._odometer.forward_b) * self._speed
        F, Q = transition(T, *self._noise)
        X = F @ self._X
        P = F @ self._P @ F.T + Q
        self._respond(X, epoch, d)
        if standing or travel is not None:
            self._epochs += 1
            d = self._observe(X, P, epoch, travel, d)
        else:
            if self._judge is not None:
                d = self._believe_imu(X, d, X[POSITION] @ self._judge.z - d)
            X[POSITION] = P[POSITION] = 0.0
            P[:, POSITION] = 0.0
            P[POSITION, POSITION] = self._odometer.start_noise(C @ epoch.C_end)
        self._X, self._P = X, P
        turn = 2.0 * epoch.q_end[1:]
        self._turned += C @ turn
        self._angle += math.sqrt(turn @ turn)
        self._BC += C @ epoch.B
        self._C = C @ epoch.C_end
        self._way += d
        self._time_s += T
        self._stamp_ns = epoch.stamp_ns
        if self._epochs >= self._next_judge:
            self._next_judge = math.ceil(JUDGED_SHARE * self._epochs)
            self._judge = solve_sums(self._sums)
        if self._refused > MOST_REFUSED:
            self._restart()

    def _respond(self, X: Array, epoch: AidedEpoch, d: Array) -> None:
        """Add what the epoch does to position and velocity; d : (3,) displacement [m]."""
        T, C, g = epoch.duration_s, self._C, self._gravity
        u, s, CB = C @ epoch.u, C @ epoch.s, C @ epoch.B
        half = 0.5 * T * T
        # Means of up(t) over the epoch with weights 1 and T - t: up is as good as linear.
        for rows, moment, weight in ((VELOCITY, T / 2.0, T), (POSITION, T / 3.0, half)):
            up = exp_rotation(self._w_n * (self._time_s + moment))[:, 2]
            X[rows, ATTITUDE] -= _times_columns((weight * g) * up, UNIT)
        coriolis = _times_columns(self._w_n, skew3(d))  # d x w
        X[VELOCITY, ATTITUDE] += coriolis
        X[POSITION, ATTITUDE] += 0.5 * T * coriolis
        U = skew3(u)
        UB = U @ CB
        X[VELOCITY, GYRO_BIAS] += self._gyro_sigma * (U @ self._BC + 0.5 * UB)
        X[POSITION, GYRO_BIAS] += self._gyro_sigma * (skew3(s) @ self._BC + (T / 6.0) * UB)
        X[VELOCITY, ACCEL_BIAS] -= self._accel_sigma * CB
        X[POSITION, ACCEL_BIAS] -= self._accel_sigma * (C @ epoch.BB)
        bend = g / self._radius
        X[VELOCITY, DATA] += u - bend * T * (self._way + 0.5 * d)
        X[POSITION, DATA] += s - bend * half * (self._way + d / 3.0)

    def _believe_imu(self, X: Array, d: Array, miss: Array) -> Array:
        """The displacement by the IMU, which is d + miss, and what follows for the velocity."""
        X[VELOCITY, ATTITUDE] += _times_columns(self._w_n, skew3(miss))
        return d + miss

    def _observe(
        self, X: Array, P: Array, epoch: AidedEpoch, travel: Travel | None, d: Array
    ) -> Array:
        """Take in the displacement by the odometer; None: there is none, the vehicle stands.

        Returns
        -------
        (3,) the displacement that is to be believed [m]
        """
        C, odometer = self._C, self._odometer
        dv = None
        if self._judge is not None:
            dv = (X[VELOCITY] - self._X[VELOCITY]) @ self._judge.z
        X[POSITION] -= odometer.displacement(C, epoch, travel, dv)
        if travel is not None:
            drift = self._gyro_sigma * (self._BC + 0.5 * (C @ epoch.B))
            X[POSITION, GYRO_BIAS] -= skew3(d) @ drift
            P[POSITION, POSITION] += odometer.way_noise(C, epoch, travel)
        S = P[POSITION, POSITION] + odometer.end_noise(C @ epoch.C_end, travel)
        implausible = False
        if self._judge is not None:
            J = X[POSITION, :DATA] @ self._judge.tangent
            miss = X[POSITION] @ self._judge.z
            nis = float(miss @ np.linalg.solve(S + J @ self._judge.covariance @ J.T, miss))
            implausible = nis > IMPLAUSIBLE
            if implausible:
                wide = nis / IMPLAUSIBLE * float(miss @ miss) * UNIT
                P[POSITION, POSITION] += wide
                S += wide
                d = self._believe_imu(X, d, miss)
        self._refused = self._refused + 1 if implausible else 0
        inverse = np.linalg.inv(S)
        E = X[POSITION].copy()
        weighted = inverse @ E
        self._sums += E.T @ weighted
        column = P[:, POSITION].copy()
        X -= column @ weighted
        P -= column @ inverse @ column.T
        # Left to itself the asymmetry of rounding would grow.
        P += P.T.copy()
        P *= 0.5
        return d

    @property
    def attitude(self) -> CoarseAttitude | None:
        """From all epochs so far; None before there are enough of them, and after a new start."""
        if self._epochs < LEAST_EPOCHS:
            return None
        found = solve_sums(self._sums)
        grade, t = self._grade, self._time_s
        up = found.R @ exp_rotation(self._w_n * t)[:, 2]
        # psi: by the bias, and where gravity seems to have walked to; its response to errors.
        gyro = self._gyro_sigma * self._BC
        tilt = -skew3(up) / self._gravity
        psi = gyro @ found.z[GYRO_BIAS] + tilt @ (self._X[WALK] @ found.z)
        J = tilt @ self._X[WALK, :DATA] @ found.tangent
        J[:, :3] += UNIT
        J[:, 3:6] += gyro
        covariance = J @ found.covariance @ J.T + tilt @ self._P[WALK, WALK] @ tilt.T
        covariance += grade.gyro_arw**2 * t * np.outer(up, up)
        covariance += grade.gyro_scale**2 * np.outer(self._turned, self._turned)
        # A misaligned gyro that turns nods, by no more than this.
        covariance += grade.misalignment**2 * min(self._angle**2, 2.0) * UNIT
        C_nb0 = exp_rotation(-self._w_n * t) @ found.R.T
        place = self._position
        moved = transport_rate_n(place.latitude, place.altitude, C_nb0 @ self._way)
        C_nb0 = exp_rotation(-moved) @ C_nb0
        phi = C_nb0 @ covariance @ C_nb0.T
        phi[2, 2] = variance = max(float(phi[2, 2]), found.heading_variance)
        # Up turns with the Earth, about an axis that is known no better than the heading.
        tilted = math.hypot(self._w_n[0], self._w_n[1]) * t * min(0.5 * variance, 1.0)
        phi[:2, :2] += tilted**2 * UNIT[:2, :2]
        C_nb = C_nb0 @ exp_rotation(-psi) @ self._C
        return CoarseAttitude(self._stamp_ns, C_nb, found.R.T, phi)


def _times_columns(a: Array, M: Array) -> Array:
    """M @ (a_1 R_e + a_2 R_n + a_3 R_u) as a function of the columns of R: (3, 9)."""
    product: Array = a[np.newaxis, :, np.newaxis] * M[:, np.newaxis, :]
    return product.reshape(3, 9)
