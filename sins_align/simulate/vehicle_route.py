"""The drives by name: how fast along the way, and how the way bends and climbs."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.random import Generator

from sins_align.simulate.vehicle_laws import LevelPlan, SinusoidSum, SmoothLevels
from sins_align.types import Array

_TURN_SPEED = 5.0  # [m/s]
_TURN_RADIUS = 14.0  # [m]
_TURN_ENTRY = 10.0  # [m] over which the curvature of a turn builds up
_MEAN_ACCELERATION = 1.0  # [m/s^2]; the largest is 2.46 times as much


@dataclass(frozen=True, eq=False)
class Route:
    """Speed over time; course, slope and ground over the distance driven (signed).

    speed : [m/s] over time [s], negative in reverse
    curvature : of the way [rad/m], clockwise, over distance [m]
    wander : added to the course [rad] over distance [m]
    slope : of the way [rad], up positive, over distance [m]
    ground : the share of the ground's tilt at the start, over distance [m]
    """

    speed: SmoothLevels
    curvature: SmoothLevels
    wander: SinusoidSum
    slope: SinusoidSum
    ground: SmoothLevels


@dataclass
class _Draft:
    """A route being planned; `end` [s] is how far it must reach.

    The streams decide: one for what happens when, one for what happens where. A longer drive
    draws more of both and must not mix them.
    """

    stream: Generator
    course_stream: Generator
    end: float
    speed: LevelPlan
    curvature: LevelPlan

    def random(self, low: float, high: float) -> float:
        """A number between two."""
        return float(self.stream.uniform(low, high))

    def sign(self) -> float:
        """Left or right."""
        return 1.0 if self.stream.random() < 0.5 else -1.0

    def go_to(self, speed: float) -> None:
        """Change the speed at the usual acceleration."""
        change = abs(speed - self.speed.level)
        self.speed.change(speed, max(change / _MEAN_ACCELERATION, 2.0))

    def vary(self, low: float, high: float, until: float) -> None:
        """Speeds slowly varying between two, up to the time `until` or a little later."""
        while self.speed.position < until:
            self.speed.change(self.random(low, high), self.random(10.0, 20.0))
            self.speed.hold(self.random(2.0, 8.0))

    def bend(self, radius: float, angle: float, entry: float) -> float:
        """Bend the way from here on by `angle` (signed); the length of the bend [m]."""
        plan = self.curvature
        plan.hold(self.speed.integral - plan.position)
        curvature = math.copysign(1.0 / radius, angle)
        plan.change(curvature, entry)
        plan.hold(radius * abs(angle) - entry)
        plan.change(0.0, entry)
        return radius * abs(angle) + entry

    def turn(self) -> None:
        """Slow down, turn left or right by 90 degrees."""
        self.go_to(_TURN_SPEED)
        angle = self.sign() * 0.5 * math.pi
        self.speed.hold(self.bend(_TURN_RADIUS, angle, _TURN_ENTRY) / _TURN_SPEED)

    def leg(self, stop_chance: float, arc_chance: float) -> None:
        """Drive to the next crossing, perhaps along an arc, perhaps stop there, and turn."""
        self.go_to(self.random(8.0, 14.0))
        self.speed.hold(self.random(3.0, 12.0))
        if self.stream.random() < arc_chance:
            radius, angle = self.random(80.0, 120.0), self.sign() * self.random(0.8, 2.0)
            self.speed.hold(self.bend(radius, angle, 20.0) / self.speed.level)
        if self.stream.random() < stop_chance:
            self.go_to(0.0)
            self.speed.hold(self.random(5.0, 15.0))
        self.turn()


def _circle(draft: _Draft) -> None:
    """Steer into a circle, and hold it as a driver does: the radius wavers.

    On a perfect one a wheel that is off by some centimetres sideways could not be told from
    a scale error, ever.
    """
    stream, plan = draft.course_stream, draft.curvature
    sign = 1.0 if stream.random() < 0.5 else -1.0
    while plan.position < 12.0 * draft.end:  # no circle is driven faster
        plan.change(sign / stream.uniform(50.0, 70.0), 25.0)
        plan.hold(stream.uniform(30.0, 120.0))


def _ring(draft: _Draft) -> None:
    draft.speed.hold(3.0)
    draft.speed.change(10.0, 10.0)
    draft.vary(8.0, 12.0, draft.end)
    _circle(draft)


def _figure8(draft: _Draft) -> None:
    radius, entry = 50.0, 20.0
    curvature = draft.sign() / radius
    draft.curvature = plan = LevelPlan(curvature)
    draft.speed.hold(3.0)
    draft.speed.change(8.0, 10.0)
    draft.vary(7.5, 8.5, draft.end)
    while plan.position < draft.speed.integral:
        plan.hold(math.tau * radius)
        curvature = -curvature
        plan.change(curvature, entry)


def _urban(draft: _Draft) -> None:
    draft.speed.hold(draft.random(8.0, 12.0))
    while draft.speed.position < draft.end:
        draft.leg(stop_chance=0.5, arc_chance=0.0)


def _straight(draft: _Draft) -> None:
    draft.speed.hold(3.0)
    draft.speed.change(15.0, 15.0)
    draft.vary(12.0, 18.0, draft.end)


def _static(draft: _Draft) -> None:
    pass


def _reverse(draft: _Draft) -> None:
    draft.speed.hold(3.0)
    while draft.speed.position < draft.end:
        begin = draft.speed.position
        draft.speed.change(10.0, 10.0)
        draft.vary(8.0, 12.0, begin + 100.0)
        draft.go_to(0.0)
        draft.speed.hold(draft.random(4.0, 8.0))
        draft.speed.change(-draft.random(3.0, 5.0), 6.0)
        draft.speed.hold(48.0)
        draft.speed.change(0.0, 6.0)
        draft.speed.hold(draft.random(4.0, 8.0))
    _circle(draft)


def _moving_start(draft: _Draft) -> None:
    draft.speed = LevelPlan(10.0)
    draft.speed.hold(draft.random(5.0, 15.0))
    draft.turn()
    while draft.speed.position < draft.end:
        draft.leg(stop_chance=0.25, arc_chance=0.6)


@dataclass(frozen=True)
class _Kind:
    """How a drive is planned, how much its way climbs and its course wanders [deg]."""

    plan: Callable[[_Draft], None]
    slope_deg: float
    wander_deg: float = 0.0


_KINDS: Mapping[str, _Kind] = MappingProxyType(
    {
        "ring": _Kind(_ring, 1.0),
        "figure8": _Kind(_figure8, 1.0),
        "urban": _Kind(_urban, 3.0, 0.3),
        "straight": _Kind(_straight, 2.0, 0.2),
        "static": _Kind(_static, 0.0),
        "reverse": _Kind(_reverse, 1.0),
        "moving_start": _Kind(_moving_start, 2.0, 0.2),
    }
)

VEHICLE_SCENARIOS: tuple[str, ...] = tuple(_KINDS)


def plan_route(scenario: str, duration_s: float, streams: Mapping[str, Generator]) -> Route:
    """The route of a scenario of `VEHICLE_SCENARIOS`; a longer one only goes on further."""
    stream = streams["vehicle_route"]
    kind = _KINDS[scenario]
    slope = _waves(kind.slope_deg, 250.0, 900.0, stream)
    wander = _waves(kind.wander_deg, 200.0, 600.0, stream)
    draft = _Draft(
        stream, streams["vehicle_course"], duration_s + 10.0, LevelPlan(0.0), LevelPlan(0.0)
    )
    kind.plan(draft)
    ground = LevelPlan(1.0)
    ground.hold(5.0)
    ground.change(0.0, 60.0)
    return Route(draft.speed.law(), draft.curvature.law(), wander, slope, ground.law())


def _waves(limit_deg: float, shortest: float, longest: float, stream: Generator) -> SinusoidSum:
    """Three sinusoids over distance whose sum stays within the limit; wavelengths in [m]."""
    wavelength: Array = stream.uniform(shortest, longest, 3)
    phase = stream.uniform(0.0, math.tau, 3)
    share = np.array([0.5, 0.3, 0.2]) * math.radians(limit_deg)
    return SinusoidSum(share, math.tau / wavelength, phase)
