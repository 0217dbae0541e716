"""What the odometer measures, and what is unknown about it.

Over an epoch the odometer's point moves by

    path + (C_end - C_start) l = int C f dS / (1 + K) - position noise

l: lever arm from the IMU to it; K: scale error; f = (1, t_l, t_v) / |.| in the vehicle's axes
m: direction of travel, with

    t_l = mounting yaw + slow part + sideslip gradient x lateral acceleration
    t_v = - mounting pitch + slow part + suspension gradient x forward acceleration

S is read at the time of the IMU plus the latency. The slow parts are first-order
Gauss-Markov; the position noise (the quantisation) is white in position, so that it is
differenced in the path. Everything here is independent of the navigation frame: the wander
filters and the Gauss-Hermite filters share it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sins_align.config import OdometerConfig
from sins_align.odo.epoch import AidedEpoch, Travel
from sins_align.rotation import dcm_from_rpy, exp_rotation, rpy_from_dcm, skew3, unskew3
from sins_align.types import Array, OdometerEstimate

# Of the fourteen states.
SCALE, LATENCY = 0, 1
LEVER = slice(2, 5)
MOUNTING = slice(5, 7)  # lateral and vertical tangent
DIRECTION = slice(7, 9)
GRADIENT = slice(9, 11)
POSITION = slice(11, 14)
COUNT = 14

DIRECTION_TIME_S = np.array([2.0, 1.0])
GRADIENT_SIGMA = math.radians(0.3)  # [rad/(m/s^2)]
MOUNTING_WALK = 1e-6  # [rad/sqrt(s)]
LEAST_SIGMA = 1e-9
# A count is lost or won anywhere within a quantum: 1/sqrt(12) of it, and some more for the
# interval's own end, which is not the epoch's.
QUANTUM_SHARE = 0.35
# A vehicle that stands: how far wind and people move it, and the rest of the noise [m].
STANDING_SIGMA = 1e-3
STANDING_NOISE = 3e-4
# Growth of the declared noise: chi-square of one degree of freedom, 90 %.
GROWTH_LIMIT = 2.7
GROWTH_UP, GROWTH_DOWN, GROWTH_MOST = 1.6, 0.9, 1e6
# Epochs come in few lengths; irregular stamps must not fill the memory.
KEPT_DURATIONS = 32
AT_REST = Travel(np.zeros((3, 3)), np.zeros((3, 3)), 0.0, 0.0, 0.0, 0.0)


class Displacement(NamedTuple):
    """The odometer's displacement over an epoch, against that of the navigation.

    residual : (3,) what is measured minus what the errors of the state explain: path plus
        lever arm minus the odometer's [m]
    arm : (3,) residual = - phi x arm + ... : what a misalignment turns [m]
    H : (3, COUNT) by the odometer's states
    R : (3, 3) covariance of its white noise [m^2]
    """

    residual: Array
    arm: Array
    H: Array
    R: Array


class OdometerModel:
    """The estimates of the odometer's states.

    config : what is declared
    x : (COUNT,) scale error, latency beyond the declared one [s], lever arm [m], tangents of
        the mounting, slow direction, gradients [rad/(m/s^2)], position noise at the end of
        the last epoch, in m [m]
    """

    def __init__(self, config: OdometerConfig) -> None:
        self.config = config
        self.C_bm = dcm_from_rpy(*config.mounting_rpy.tolist())
        self.x = np.zeros(COUNT)
        self.x[LEVER] = config.lever_arm
        self._growth = np.ones(3)  # of the declared variance, along the axes of m
        self._kept: dict[float, tuple[Array, Array]] = {}
        self.quantum = config.quantum if config.quantum is not None else 0.0

    def prior_variance(self) -> Array:
        """(COUNT,) variances at the start; all independent."""
        config = self.config
        sigma = np.empty(COUNT)
        sigma[SCALE], sigma[LATENCY] = config.scale_sigma, config.latency_sigma
        sigma[LEVER] = config.lever_arm_sigma
        sigma[MOUNTING] = config.mounting_sigma
        sigma[DIRECTION] = config.direction_sigma
        sigma[GRADIENT] = GRADIENT_SIGMA
        sigma[POSITION] = self.position_sigma(False)
        return np.maximum(sigma, LEAST_SIGMA) ** 2

    def position_sigma(self, standing: bool) -> Array:
        """(3,) 1 sigma of the position noise, in m [m]."""
        if standing:
            return np.full(3, STANDING_SIGMA)
        return np.array([max(QUANTUM_SHARE * self.quantum, LEAST_SIGMA), LEAST_SIGMA, LEAST_SIGMA])

    def advance(self, duration: float) -> tuple[Array, Array]:
        """Carry the estimates over an epoch.

        Returns
        -------
        (COUNT,) factors of the errors, and the variances that are added to them. The
        position noise at the end has nothing to do with that at the start: its factor is
        zero, and `position_sigma` what it gets
        """
        kept = self._kept.get(duration)
        if kept is None:
            config = self.config
            factor, variance = np.ones(COUNT), np.zeros(COUNT)
            decay = np.exp(-duration / DIRECTION_TIME_S)
            factor[DIRECTION] = decay
            factor[POSITION] = 0.0
            variance[SCALE] = config.scale_walk**2 * duration
            variance[LATENCY] = config.latency_walk**2 * duration
            variance[MOUNTING] = MOUNTING_WALK**2 * duration
            variance[DIRECTION] = config.direction_sigma**2 * (1.0 - decay * decay)
            kept = factor, variance
            if len(self._kept) >= KEPT_DURATIONS:
                self._kept.clear()
            self._kept[duration] = kept
        self.x = self.x * kept[0]
        return kept

    def measure(
        self,
        epoch: AidedEpoch,
        C_start: Array,
        C_end: Array,
        path: Array,
        turn: Array,
        standing: bool,
    ) -> Displacement:
        """The displacement of an epoch.

        Parameters
        ----------
        C_start, C_end : (3, 3) attitude in the navigation frame at the ends
        path : (3,) int v dt in the navigation frame as it turns [m]
        turn : (3,) rotation of the navigation frame over the epoch [rad]
        """
        x, T = self.x, epoch.duration_s
        travel = AT_REST if standing or epoch.travel is None else epoch.travel
        moved = C_end - C_start
        # The frame turns under the displacement: half of it, on the whole.
        C = C_start - skew3(0.5 * turn) @ C_start
        scaled = (C / (1.0 + x[SCALE])) @ travel.M
        Cm = scaled @ self.C_bm
        acceleration = self._accelerations(epoch, travel)
        lateral, vertical = (x[MOUNTING] + x[DIRECTION] + x[GRADIENT] * acceleration).tolist()
        shorter = 1.0 / math.sqrt(1.0 + lateral * lateral + vertical * vertical)
        f = np.array([shorter, shorter * lateral, shorter * vertical])
        D = Cm @ f
        H = np.zeros((3, COUNT))
        H[:, SCALE] = D / (1.0 + x[SCALE])
        H[:, LATENCY] = C @ (travel.M_rate @ (self.C_bm @ f)) / -(1.0 + x[SCALE])
        H[:, LEVER] = moved
        # f has length 1: a tangent turns it, and takes as much off along it.
        sideways = shorter * (D[:, None] * f[1:] - Cm[:, 1:])
        H[:, MOUNTING] = H[:, DIRECTION] = sideways
        H[:, GRADIENT] = sideways * acceleration
        arm = moved @ x[LEVER] - D
        mean = C @ epoch.B @ (self.C_bm / T)
        R = (mean * self._variance(travel, T, standing)) @ mean.T
        return Displacement(path + arm, arm, H, R)

    def _variance(self, travel: Travel, duration: float, standing: bool) -> Array:
        """(3,) white noise of the displacement, in m [m^2]."""
        if standing:
            return np.full(3, STANDING_NOISE**2)
        # Declared for a second: white, it grows with the root of the time.
        config, speed = self.config, abs(travel.distance) / duration
        sigma = config.noise + config.noise_per_m * speed
        variance = self._growth * (sigma * sigma * duration)
        variance[0] += travel.variance
        return variance

    def adapt(self, axes: Array, innovation: Array, S: Array) -> None:
        """Let the noise grow where innovations are larger than their covariance says.

        Where one along an axis of m exceeds the square that one in ten should, the declared
        variance is multiplied by 1.6; where not, by 0.9 down to what is declared. So one in
        five is let exceed it. An odometer worse than declared must not make sigma lie; how
        large an outlier is does not matter.

        Parameters
        ----------
        axes : (3, 3) C_am; innovation : (3,) [m]; S : (3, 3) its covariance [m^2]
        """
        square = (innovation @ axes) ** 2
        exceeds = square > GROWTH_LIMIT * ((S @ axes) * axes).sum(axis=0)
        growth = self._growth * np.where(exceeds, GROWTH_UP, GROWTH_DOWN)
        self._growth = np.minimum(np.maximum(growth, 1.0), GROWTH_MOST)

    def _accelerations(self, epoch: AidedEpoch, travel: Travel) -> Array:
        """(2,) lateral (left) and forward acceleration of the vehicle, means [m/s^2]."""
        T = epoch.duration_s
        # Rotation about the vehicle's up axis over the epoch, for angles of a vehicle.
        turned = float(self.C_bm[:, 2] @ unskew3(epoch.C_end))
        forward = (travel.speed_end - travel.speed_start) / T
        return np.array([turned * travel.distance / (T * T), forward])

    def estimate(self, error: Array, covariance: Array) -> OdometerEstimate:
        """In the terms of the interface, given mean (COUNT,) and covariance of the errors."""
        x, sigma = self.x - error, np.sqrt(covariance.diagonal())
        # Turning by -pitch about y lifts the tangent, by yaw about z it moves it to the left.
        tangents = self.C_bm @ np.array([[0.0, 0.0], [0.0, -1.0], [1.0, 0.0]])
        C_bm = exp_rotation(tangents @ x[MOUNTING]) @ self.C_bm
        return OdometerEstimate(
            scale_error=float(x[SCALE]),
            scale_sigma=float(sigma[SCALE]),
            latency_s=self.config.latency + float(x[LATENCY]),
            latency_sigma_s=float(sigma[LATENCY]),
            mounting_rpy=np.array(rpy_from_dcm(C_bm)),
            mounting_covariance=tangents @ covariance[MOUNTING, MOUNTING] @ tangents.T,
            lever_arm_b=x[LEVER].copy(),
            lever_arm_covariance=covariance[LEVER, LEVER].copy(),
        )
