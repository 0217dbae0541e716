"""Where the vehicle gets to, and what a perfect IMU feels on the way."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sins_align.simulate.attitude_motion import Attitude
from sins_align.simulate.geodesy import plumb_gravity
from sins_align.simulate.vehicle_earth import (
    earth_rates_n,
    meridian_radius,
    normal_radius,
    transport_acceleration_n,
    transport_rate_n,
)
from sins_align.simulate.vehicle_motion import Kinematics, VehicleMotion
from sins_align.types import Array

# The grid of the position: the quickest motion, 5 Hz, turns by 1.6 rad within a step, for
# which the four nodes are good to a micrometre.
_STEP = 0.05  # [s]
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(4)
# Within this distance of a pole the axes of n turn too fast.
_MOST_LATITUDE = math.radians(89.99)
_BLOCK = 4096


class Place(NamedTuple):
    """Geodetic position of the IMU at N times [rad], [rad], [m]."""

    latitude: Array
    longitude: Array
    altitude: Array


class ImuMotion(NamedTuple):
    """Motion of the IMU at N times; v_n, a_n (3, N): ENU components, their derivatives."""

    attitude: Attitude
    v_n: Array
    a_n: Array


@dataclass(frozen=True, eq=False)
class Track:
    """The IMU's way over the Earth.

    motion : of the vehicle; lever_arm_b : (3,) IMU to the odometer's point, in b [m]
    begin, end : of the time that the track covers [s]
    values, rates : (3, M) latitude, longitude, altitude on the grid, and their derivatives
    gravity : (M,) on the grid [m/s^2]
    """

    motion: VehicleMotion
    lever_arm_b: Array
    begin: float
    end: float
    values: Array
    rates: Array
    gravity: Array

    def place(self, t: Array) -> Place:
        """Position of the IMU at the times t (N,) [s].

        Raises
        ------
        ValueError : a time that the track does not cover
        """
        if t.size and not (self.begin <= t.min() and t.max() <= self.end):
            raise ValueError(f"time: the track covers {self.begin}..{self.end} s only")
        return Place(*_interpolate(self.values, self.rates, (t - self.begin) / _STEP))

    def imu_motion(self, t: Array) -> ImuMotion:
        """Attitude, velocity and acceleration of the IMU at the times t (N,) [s]."""
        return imu_motion(self.motion.kinematics(t), self.lever_arm_b, self.place(t))

    def sense(self, t: Array) -> tuple[Array, Array]:
        """w_ib_b (3, N) [rad/s] and f_ib_b (3, N) [m/s^2] at the times t (N,) [s]."""
        w, f = np.empty((3, t.size)), np.empty((3, t.size))
        for first in range(0, t.size, _BLOCK):
            block = slice(first, first + _BLOCK)
            w[:, block], f[:, block] = self._sense_block(t[block])
        return w, f

    def sense_mean(self, begin: Array, end: Array) -> tuple[Array, Array]:
        """Means over (begin, end] (N,) [s] of w_ib_b and f_ib_b, both in b as it turns."""
        # Three nodes do for 5 Hz at 50 Hz and above; longer intervals need more.
        longest = float(np.max(end - begin))
        nodes, weights = np.polynomial.legendre.leggauss(3 + math.ceil(20.0 * longest - 0.4))
        w, f = np.zeros((3, begin.size)), np.zeros((3, begin.size))
        middle, half = 0.5 * (begin + end), 0.5 * (end - begin)
        for node, weight in zip(nodes, weights, strict=True):
            w_node, f_node = self.sense(middle + node * half)
            w += 0.5 * weight * w_node
            f += 0.5 * weight * f_node
        return w, f

    def _sense_block(self, t: Array) -> tuple[Array, Array]:
        place = self.place(t)
        (C_nb, w_nb_b, _), v_n, a_n = imu_motion(self.motion.kinematics(t), self.lever_arm_b, place)
        w_ie_n = earth_rates_n(place.latitude)
        w_en_n = transport_rate_n(v_n, place.latitude, place.altitude)
        f_n = a_n + cross(2.0 * w_ie_n + w_en_n, v_n)
        f_n[2] += np.interp((t - self.begin) / _STEP, np.arange(self.gravity.size), self.gravity)
        return w_nb_b + to_body(C_nb, w_ie_n + w_en_n), to_body(C_nb, f_n)


def imu_motion(kinematics: Kinematics, lever_arm_b: Array, place: Place) -> ImuMotion:
    """The IMU's motion from that of the odometer's point O, at l from the IMU.

    v_imu = v_O - w_eb x l with w_eb = w_nb + w_en, and its derivative. w_en is taken at O: the
    IMU's differs by 1e-7 of the lever's speed.
    """
    attitude, v_n, a_n = kinematics
    if not np.any(lever_arm_b):
        return ImuMotion(attitude, v_n, a_n)
    C_nb, w, dw = attitude
    l_b = np.broadcast_to(lever_arm_b[:, np.newaxis], w.shape)
    w_l = cross(w, l_b)
    l_n, dl_n = to_navigation(C_nb, l_b), to_navigation(C_nb, w_l)
    ddl_n = to_navigation(C_nb, cross(w, w_l) + cross(dw, l_b))
    w_en = transport_rate_n(v_n, place.latitude, place.altitude)
    dw_en = transport_acceleration_n(v_n, a_n, place.latitude, place.altitude)
    return ImuMotion(
        attitude,
        v_n - dl_n - cross(w_en, l_n),
        a_n - ddl_n - cross(w_en, dl_n) - cross(dw_en, l_n),
    )


def integrate_track(
    motion: VehicleMotion,
    lever_arm_b: Array,
    start: tuple[float, float, float],
    span: tuple[float, float],
) -> Track:
    """Integrate the IMU's velocity to its position.

    L' = v_N / (R_M(L) + h), lambda' = v_E / ((R_N(L) + h) cos L), h' = v_U. The right sides
    depend so little on L and h that four rounds of integrals over the whole track are exact.

    Parameters
    ----------
    lever_arm_b : (3,) IMU to the odometer's point, in b [m]
    start : latitude, longitude [rad] and altitude [m] of the IMU at 0 s
    span : times to cover, 0 s among them [s]

    Raises
    ------
    ValueError : the vehicle would come too near to a pole
    """
    back, forth = math.ceil(-span[0] / _STEP), math.ceil(span[1] / _STEP)
    count = back + forth + 1
    begin = -back * _STEP
    grid: Array = begin + _STEP * np.arange(count, dtype=np.float64)
    part: Array = 0.5 * (1.0 + np.asarray(_NODES, dtype=np.float64))
    node_times: Array = grid[:-1, np.newaxis] + _STEP * part
    at_nodes = motion.kinematics(node_times.ravel())
    at_grid = motion.kinematics(grid)
    values = np.repeat(np.array(start)[:, np.newaxis], count, axis=1)
    rates = np.zeros((3, count))
    index = (np.arange(count - 1)[:, np.newaxis] + part).ravel()
    for _ in range(4):
        node_rates = _rates(at_nodes, lever_arm_b, Place(*_interpolate(values, rates, index)))
        pieces = _STEP * 0.5 * (node_rates.reshape(3, -1, _WEIGHTS.size) @ _WEIGHTS)
        values = np.concatenate((np.zeros((3, 1)), np.cumsum(pieces, axis=1)), axis=1)
        values += np.array(start)[:, np.newaxis] - values[:, back : back + 1]
        if np.max(np.abs(values[0])) > _MOST_LATITUDE:
            raise ValueError("latitude_deg: the vehicle would come too near to a pole")
        rates = _rates(at_grid, lever_arm_b, Place(*values))
    gravity = [plumb_gravity(float(L), float(h)) for L, h in zip(values[0], values[2], strict=True)]
    return Track(motion, lever_arm_b, begin, float(grid[-1]), values, rates, np.array(gravity))


def _rates(kinematics: Kinematics, lever_arm_b: Array, place: Place) -> Array:
    """(3, N) derivatives of latitude, longitude and altitude."""
    v_n = imu_motion(kinematics, lever_arm_b, place).v_n
    latitude, altitude = place.latitude, place.altitude
    return np.stack(
        (
            v_n[1] / (meridian_radius(latitude) + altitude),
            v_n[0] / ((normal_radius(latitude) + altitude) * np.cos(latitude)),
            v_n[2],
        )
    )


def _interpolate(values: Array, rates: Array, index: Array) -> Array:
    """(3, N) cubic Hermite interpolation at fractional places of the grid."""
    k = np.clip(index.astype(np.intp), 0, values.shape[1] - 2)
    u = index - k
    rise = values[:, k + 1] - values[:, k]
    low, high = _STEP * rates[:, k] - rise, rise - _STEP * rates[:, k + 1]
    return values[:, k] + u * rise + u * (1.0 - u) * ((1.0 - u) * low + u * high)


def to_body(C_nb: Array, x_n: Array) -> Array:
    """(3, N) C_bn x_n."""
    return np.einsum("jin,jn->in", C_nb, x_n)


def to_navigation(C_nb: Array, x_b: Array) -> Array:
    """(3, N) C_nb x_b."""
    return np.einsum("ijn,jn->in", C_nb, x_b)


def cross(a: Array, b: Array) -> Array:
    """(3, N) cross product over the columns; np.cross is several times slower."""
    return np.stack(
        (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])
    )
