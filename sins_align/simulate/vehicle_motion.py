"""How the vehicle moves along its route, and the IMU on it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from sins_align.simulate.attitude_motion import (
    Attitude,
    AxisRotation,
    FixedRotation,
    RotationStep,
    compose_attitude,
)
from sins_align.simulate.vehicle_laws import (
    Rows,
    SinusoidSum,
    along,
    band,
    correlated,
    liveliness,
    product,
    random_sinusoids,
)
from sins_align.simulate.vehicle_options import VehicleOptions
from sins_align.simulate.vehicle_route import Route, plan_route
from sins_align.types import Array

_HALF_SPEED = 3.0  # [m/s] at which road motion has half its full size


class Way(NamedTuple):
    """Where the way leads at N times; row k is the k-th derivative by time.

    distance : (5, N) signed travel of the odometer's reference point [m], speed [m/s], ...
    course : (4, N) clockwise from north [rad]
    slope : (3, N) upwards [rad]
    bank : (3, N) of the ground, right side down [rad]
    """

    distance: Rows
    course: Rows
    slope: Rows
    bank: Rows


class Kinematics(NamedTuple):
    """Attitude of b, velocity and acceleration of the odometer's reference point O, in ENU.

    attitude : C_nb, w_nb_b, dw_nb_b
    v_n : (3, N) [m/s], a_n : (3, N) time derivative of its components [m/s^2]
    """

    attitude: Attitude
    v_n: Array
    a_n: Array


@dataclass(frozen=True)
class Gradients:
    """Sideslip, suspension roll and pitch against acceleration [rad/(m/s^2)]."""

    sideslip: float
    roll: float
    pitch: float


@dataclass(frozen=True, eq=False)
class _Known:
    """An angle law whose values are at hand for the very times it is asked for."""

    rows: Rows

    def __call__(self, t: Array) -> tuple[Array, Array, Array]:
        """As `AngleLaw`."""
        return self.rows[0], self.rows[1], self.rows[2]


@dataclass(frozen=True, eq=False)
class VehicleMotion:
    """The vehicle on its route.

    heading : course at the start [rad]
    ground_roll, ground_pitch : tilt of the ground at the start, REP-103 [rad]
    road : roll and pitch that the road adds when driving [rad]
    direction : yaw and pitch of the vehicle against its travel [rad], when driving
    standing : roll, pitch and yaw when standing [rad]
    C_bm : (3, 3) vehicle axes to b
    """

    route: Route
    heading: float
    ground_roll: float
    ground_pitch: float
    gradients: Gradients
    road: tuple[SinusoidSum, SinusoidSum]
    direction: tuple[SinusoidSum, SinusoidSum]
    standing: tuple[SinusoidSum, SinusoidSum, SinusoidSum]
    C_bm: Array

    def way(self, t: Array) -> Way:
        """Where the way leads at the times t (N,) [s]."""
        route = self.route
        distance = route.speed(t)
        s = distance[0]
        course = route.curvature(s)[:4] + route.wander(s, 4)
        course[0] += self.heading - route.wander(np.zeros(1), 1)[0, 0]
        ground = route.ground(s)[1:4]
        slope = route.slope(s) - self.ground_pitch * ground
        bank = self.ground_roll * ground
        return Way(
            distance,
            along(course, distance[:4]),
            along(slope, distance[:3]),
            along(bank, distance[:3]),
        )

    def attitude(self, t: Array) -> Attitude:
        """Attitude of b in n and its derivatives at the times t (N,) [s]."""
        return self._attitude(t, self.way(t))

    def kinematics(self, t: Array) -> Kinematics:
        """Attitude, and the motion of the odometer's reference point, at t (N,) [s]."""
        way = self.way(t)
        v, dv = way.distance[1], way.distance[2]
        (psi, dpsi), (gamma, dgamma) = way.course[:2], way.slope[:2]
        sin_psi, cos_psi = np.sin(psi), np.cos(psi)
        sin_gamma, cos_gamma = np.sin(gamma), np.cos(gamma)
        forward = np.stack((cos_gamma * sin_psi, cos_gamma * cos_psi, sin_gamma))
        turning = np.stack(
            (
                dpsi * cos_gamma * cos_psi - dgamma * sin_gamma * sin_psi,
                -dpsi * cos_gamma * sin_psi - dgamma * sin_gamma * cos_psi,
                dgamma * cos_gamma,
            )
        )
        return Kinematics(self._attitude(t, way), v * forward, dv * forward + v * turning)

    def _attitude(self, t: Array, way: Way) -> Attitude:
        yaw, pitch, roll = self._against_travel(t, way)
        course = -way.course[:3]
        course[0] += 0.5 * math.pi
        # Pitch is positive nose down, a slope is positive upwards.
        steps: list[RotationStep] = [
            AxisRotation(2, _Known(course)),
            AxisRotation(1, _Known(-way.slope)),
            AxisRotation(0, _Known(way.bank)),
            AxisRotation(2, _Known(yaw)),
            AxisRotation(1, _Known(pitch)),
            AxisRotation(0, _Known(roll)),
            FixedRotation(self.C_bm.T),
        ]
        return compose_attitude(steps, t)

    def _against_travel(self, t: Array, way: Way) -> tuple[Rows, Rows, Rows]:
        """Yaw, pitch and roll (3, N) of the vehicle against its travel and the ground.

        In a turn it noses inwards (sideslip) and leans outwards, when accelerating the nose
        rises.
        """
        speed = way.distance[1:4]
        lateral = product(speed, way.course[1:4])  # to the right
        lively = liveliness(speed, _HALF_SPEED)
        still = -lively
        still[0] += 1.0
        yaw = -self.gradients.sideslip * lateral + product(lively, self.direction[0](t))
        pitch = -self.gradients.pitch * way.distance[2:5]
        pitch += product(lively, self.road[1](t) + self.direction[1](t))
        roll = -self.gradients.roll * lateral + product(lively, self.road[0](t))
        for angle, motion in zip((roll, pitch, yaw), self.standing, strict=True):
            angle += product(still, motion(t))
        return yaw, pitch, roll


def vehicle_motion(options: VehicleOptions, streams: Mapping[str, Generator]) -> VehicleMotion:
    """The analytic motion that the options and the random numbers describe."""
    heading = streams["vehicle_heading"].uniform(0.0, math.tau)
    ground_roll, ground_pitch = np.radians(streams["vehicle_ground"].uniform(-2.0, 2.0, 2))
    if options.heading_deg is not None:
        heading = math.radians(options.heading_deg)
    if options.ground_roll_deg is not None:
        ground_roll = math.radians(options.ground_roll_deg)
    if options.ground_pitch_deg is not None:
        ground_pitch = math.radians(options.ground_pitch_deg)
    return VehicleMotion(
        route=plan_route(options.scenario, options.duration_s, streams),
        heading=float(heading),
        ground_roll=float(ground_roll),
        ground_pitch=float(ground_pitch),
        gradients=Gradients(
            sideslip=math.radians(options.sideslip_deg_per_m_s2),
            roll=math.radians(options.suspension_roll_deg_per_m_s2),
            pitch=math.radians(options.suspension_pitch_deg_per_m_s2),
        ),
        road=_road_motion(options, streams["vehicle_road"]),
        direction=_direction_noise(options, streams["vehicle_direction"]),
        standing=_standing_motion(options, streams["vehicle_standing"]),
        C_bm=mounting_matrix(options.mounting_rpy_deg),
    )


def mounting_matrix(rpy_deg: tuple[float, float, float]) -> Array:
    """(3, 3) C_bm = Rz(yaw) Ry(pitch) Rx(roll), vehicle axes to b."""
    (sr, sp, sy), (cr, cp, cy) = np.sin(np.radians(rpy_deg)), np.cos(np.radians(rpy_deg))
    Rz = np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]])
    Ry = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
    Rx = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    C_bm: Array = Rz @ Ry @ Rx
    return C_bm


def _road_motion(options: VehicleOptions, stream: Generator) -> tuple[SinusoidSum, SinusoidSum]:
    rms = math.radians(options.road_motion_deg)
    roll, pitch = (random_sinusoids(rms, band(0.5, 2.5, 10, stream), stream) for _ in range(2))
    return roll, pitch


def _direction_noise(options: VehicleOptions, stream: Generator) -> tuple[SinusoidSum, SinusoidSum]:
    rms = math.radians(options.direction_noise_deg)
    yaw = random_sinusoids(rms, correlated(2.0, 10, stream), stream)
    return yaw, random_sinusoids(rms, correlated(1.0, 10, stream), stream)


def _standing_motion(
    options: VehicleOptions, stream: Generator
) -> tuple[SinusoidSum, SinusoidSum, SinusoidSum]:
    rms = math.radians(options.standing_motion_arcsec / 3600.0)

    def motion() -> SinusoidSum:
        wind, engine = band(0.05, 0.3, 3, stream), band(1.0, 5.0, 3, stream)
        return random_sinusoids(rms, np.concatenate((wind, engine)), stream)

    return motion(), motion(), motion()
