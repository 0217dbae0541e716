"""The drive in the middle of a swing: the base drives off, straight on, and stops again."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from sins_align.simulate.attitude_motion import SmoothTurn
from sins_align.simulate.base_motion import CentreMotion
from sins_align.simulate.options import SwingOptions
from sins_align.simulate.vehicle_laws import SinusoidSum, band, product, random_sinusoids
from sins_align.types import Array

# From the bounce of the body on its springs to that of the wheels.
_LOW_HZ, _HIGH_HZ = 1.0, 12.0
_SINUSOIDS = 12
_PASSAGE = 0.25  # part of the drive in which the shake rises, and in which it falls


@dataclass(frozen=True, eq=False)
class RoadShake:
    """Displacement e(t) s(t) [m] that the road adds, along one direction, during a drive.

    e rises from 0 to 1 in the first quarter of the drive and falls in the last one; it is
    that of `SmoothTurn`, so the acceleration is continuous.

    vibration : s, over time [m]
    start, duration : of the drive [s]
    """

    vibration: SinusoidSum
    start: float
    duration: float

    def __call__(self, t: Array) -> tuple[Array, Array, Array]:
        """(N,) displacement [m], velocity [m/s] and acceleration [m/s^2] at the times t [s]."""
        passage = _PASSAGE * self.duration
        rise = SmoothTurn(1.0, self.start, passage)
        fall = SmoothTurn(1.0, self.start + self.duration - passage, passage)
        e = np.subtract(rise(t), fall(t))
        displacement, velocity, acceleration = product(e, self.vibration(t))
        return displacement, velocity, acceleration


def drive_motions(options: SwingOptions, stream: Generator) -> tuple[CentreMotion, ...]:
    """The drive, and the shake across it and vertically; none without a drive.

    The profile is that of `SmoothTurn`, in metres: over D in T the greatest speed is
    35/16 D/T, in the middle, and the greatest acceleration 7.51 D/T^2.
    """
    if options.drive_m == 0.0:
        return ()
    start, duration = options.drive_begin_s, options.drive_duration_s
    azimuth = math.radians(options.drive_azimuth_deg)
    forward = np.array([math.sin(azimuth), math.cos(azimuth), 0.0])
    drive = CentreMotion(forward, SmoothTurn(options.drive_m, start, duration))
    if options.drive_shake_m_s2 == 0.0:
        return (drive,)
    up = np.array([0.0, 0.0, 1.0])
    shakes = (
        CentreMotion(
            direction, RoadShake(_vibration(options.drive_shake_m_s2, stream), start, duration)
        )
        for direction in (up, np.cross(forward, up))
    )
    return (drive, *shakes)


def _vibration(rms: float, stream: Generator) -> SinusoidSum:
    """A displacement [m] whose acceleration has this rms [m/s^2], spread evenly in the band."""
    acceleration = random_sinusoids(rms, band(_LOW_HZ, _HIGH_HZ, _SINUSOIDS, stream), stream)
    omega = acceleration.omega
    return SinusoidSum(acceleration.amplitude / omega**2, omega, acceleration.phase)
