"""What IMU and odometer of a simulated base give, in parts and spoiled."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from sins_align.simulate import SwingOptions, VehicleOptions, simulate_swing, simulate_vehicle
from sins_align.simulate.attitude_motion import AxisRotation, RotationStep, SmoothTurn
from sins_align.simulate.scenarios import Still
from sins_align.types import Array, ImuSamples, OdometerSamples

RATE_HZ = 20.0
ROCK_S = 4.0


@dataclass(frozen=True, eq=False)
class Drive:
    """What IMU and odometer give; times are seconds since the start of the whole simulation."""

    imu: ImuSamples
    odometer: OdometerSamples | None
    begin_ns: int

    def part(self, begin_s: float, end_s: float = math.inf) -> Drive:
        """From the one to the other, or to the end."""
        imu, odometer = self.imu, self.odometer
        imu = imu.select(self._inside(imu.stamp_ns, begin_s, end_s))
        if odometer is not None:
            odometer = odometer.select(self._inside(odometer.stamp_ns, begin_s, end_s))
        return Drive(imu, odometer, self.begin_ns)

    def _inside(self, stamp_ns: Array, begin_s: float, end_s: float) -> Array:
        time_s = (stamp_ns - self.begin_ns) * 1e-9
        return (time_s >= begin_s) & (time_s < end_s)

    def later(self, seconds: float) -> Drive:
        """All of it at a later time."""
        return self.shifted(round(seconds * 1e9))

    def shifted(self, ns: int) -> Drive:
        imu, odometer = self.imu, self.odometer
        imu = ImuSamples(imu.stamp_ns + ns, imu.w_ib_b, imu.f_ib_b)
        if odometer is not None:
            odometer = OdometerSamples(odometer.stamp_ns + ns, odometer.speed, odometer.variance)
        return Drive(imu, odometer, self.begin_ns)

    def sensed(
        self,
        w: Callable[[Array], Array] = lambda w: w,
        f: Callable[[Array], Array] = lambda f: f,
    ) -> Drive:
        """With other angular rates or specific forces, (3, N) each."""
        imu = ImuSamples(self.imu.stamp_ns, w(self.imu.w_ib_b), f(self.imu.f_ib_b))
        return Drive(imu, self.odometer, self.begin_ns)

    def picked(self, index: slice | Array) -> Drive:
        """Only these samples of the IMU."""
        return Drive(self.imu.select(index), self.odometer, self.begin_ns)

    def at_one_time(self) -> Drive:
        """The stamps of the IMU stand still."""
        imu = self.imu
        stamps = np.full_like(imu.stamp_ns, imu.stamp_ns[0])
        return Drive(ImuSamples(stamps, imu.w_ib_b, imu.f_ib_b), self.odometer, self.begin_ns)

    def counted(self, factor: float) -> Drive:
        """The odometer's speed is so many times as much."""
        odometer = self.odometer
        assert odometer is not None
        odometer = OdometerSamples(odometer.stamp_ns, factor * odometer.speed, odometer.variance)
        return Drive(self.imu, odometer, self.begin_ns)

    @property
    def without_odometer(self) -> Drive:
        return Drive(self.imu, None, self.begin_ns)


@cache
def swing(duration_s: float = 80.0, **changes: Any) -> Drive:
    """A swing of 2 deg about each axis, 5 m from its centre; a laser gyro."""
    options = {"scenario": "level", "grade": "rlg", "seed": 1, "rate_hz": RATE_HZ, **changes}
    imu = simulate_swing(SwingOptions(duration_s=duration_s, **options)).imu
    return Drive(imu, None, int(imu.stamp_ns[0]))


@cache
def vehicle(scenario: str, duration_s: float, **changes: Any) -> Drive:
    """A drive with a fibre-optic gyro."""
    options = {"grade": "fog", "seed": 2, "rate_hz": RATE_HZ, **changes}
    run = simulate_vehicle(VehicleOptions(scenario=scenario, duration_s=duration_s, **options))
    return Drive(run.imu, run.odometer, int(run.imu.stamp_ns[0]))


@dataclass(frozen=True)
class Rocking(Still):
    """A base that is rocked to one side and back, until it is still."""

    angle_deg: float = 0.1
    until_s: float = 40.0
    name: str = "rocking"

    def rotations(self, phases: Array) -> tuple[RotationStep, ...]:
        """As `Scenario`."""
        angle = math.radians(self.angle_deg)
        count = 2 * round(self.until_s / (2.0 * ROCK_S))
        rocks = (SmoothTurn((-1) ** k * angle, k * ROCK_S, ROCK_S) for k in range(count))
        return (*(AxisRotation(0, rock) for rock in rocks), *super().rotations(phases))
