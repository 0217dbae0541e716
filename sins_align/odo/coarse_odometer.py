"""What the odometer says of an epoch, as a function of the coarse alignment's unknowns."""

from __future__ import annotations

import numpy as np

from sins_align.config import OdometerConfig
from sins_align.odo.coarse_solution import (
    DATA,
    LATENCY,
    LEVER,
    SIDESLIP,
    SIZE,
    SUSPENSION,
    TRAVEL,
)
from sins_align.odo.epoch import AidedEpoch, Travel
from sins_align.odo.odometer_model import (
    DIRECTION_TIME_S,
    GRADIENT_SIGMA,
    QUANTUM_SHARE,
    STANDING_SIGMA,
)
from sins_align.rotation import dcm_from_rpy
from sins_align.types import Array

CAUTION = 2.0


class CoarseOdometer:
    """Displacements and their noise, in b0; C (3, 3) is b to b0, at the start of an epoch."""

    def __init__(self, config: OdometerConfig) -> None:
        self._config = config
        # The declared noise is a floor. A filter's grows with its innovations; here it cannot.
        self._noise = CAUTION * config.noise
        self._noise_per_m = CAUTION * config.noise_per_m
        self.quantum = 0.0 if config.quantum is None else config.quantum
        self._C_bm = dcm_from_rpy(*config.mounting_rpy.tolist())
        self.forward_b = self._C_bm[:, 0].copy()
        eta = config.mounting_sigma
        self._travel_sigma = self._C_bm * np.array([config.scale_sigma, eta, eta])

    def displacement(
        self, C: Array, epoch: AidedEpoch, travel: Travel | None, dv: Array | None
    ) -> Array:
        """Displacement of the IMU as a function of z: (3, SIZE) [m].

        (M + tau M')(f + m) - (C_end - C) l

        Parameters
        ----------
        travel : None: the vehicle stands
        dv : (3,) change of velocity over the epoch by the IMU, in b0 [m/s]; None: not known
        """
        T, known = epoch.duration_s, self._config
        Y = np.zeros((3, SIZE))
        turn = C - C @ epoch.C_end
        Y[:, LEVER] = turn * known.lever_arm_sigma
        Y[:, DATA] = turn @ known.lever_arm
        if travel is None:
            return Y
        CM = C @ travel.M
        forward, left, up = self._C_bm.T
        CB = C @ epoch.B
        if dv is None:
            ahead = (travel.speed_end - travel.speed_start) / T
            # Of a rotation by a vehicle's angles in an epoch, twice the quaternion's vector.
            aside = 2.0 * float(up @ epoch.q_end[1:]) / T * travel.distance / T
        else:
            # The odometer's own speed is too coarse: counts within a sample.
            ahead, aside, _ = ((CB @ self._C_bm).T @ dv / (T * T)).tolist()
        Y[:, TRAVEL] = CM @ self._travel_sigma
        Y[:, LATENCY] = known.latency_sigma * ahead * (CB @ forward)
        Y[:, SIDESLIP] = GRADIENT_SIGMA * aside * (CM @ left)
        Y[:, SUSPENSION] = GRADIENT_SIGMA * ahead * (CM @ up)
        Y[:, DATA] += CM @ forward
        return Y

    def start_noise(self, C: Array) -> Array:
        """Covariance of the odometer's position: (3, 3) [m^2].

        The declared noise is that of an epoch, which has two ends; a count may be lost at each.
        """
        Cm = C @ self._C_bm
        variance = 0.5 * self._noise**2
        variance[0] += (QUANTUM_SHARE * self.quantum) ** 2
        return (Cm * variance) @ Cm.T

    def end_noise(self, C: Array, travel: Travel | None) -> Array:
        """The same at the end of an epoch, where C is b to b0; None: the vehicle stands."""
        return STANDING_SIGMA**2 * np.eye(3) if travel is None else self.start_noise(C)

    def way_noise(self, C: Array, epoch: AidedEpoch, travel: Travel) -> Array:
        """Covariance of what an epoch adds to the error of the position: (3, 3) [m^2].

        A slow error counts as the white noise of the same density at low frequency: for a
        correlation e^-T from epoch to epoch, (1 + e^-T) / (1 - e^-T) times its variance. That
        of the direction and the noise that grows with the way declare the same: the larger
        one counts.
        """
        known, T, distance = self._config, epoch.duration_s, abs(travel.distance)
        decay = np.exp(-T / DIRECTION_TIME_S)
        slow = np.zeros(3)
        slow[1:] = known.direction_sigma * distance * np.sqrt((1.0 + decay) / (1.0 - decay))
        variance = np.maximum(self._noise_per_m * distance, slow) ** 2
        variance[0] += travel.variance
        Cm = C @ (epoch.B @ self._C_bm) / T
        return (Cm * variance) @ Cm.T
