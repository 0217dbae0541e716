"""The swings by name. A scenario says how the attitude moves; `SCENARIOS` lists them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Protocol

import numpy as np

from sins_align.simulate.attitude_motion import (
    AxisRotation,
    FixedRotation,
    Linear,
    RotationStep,
    Sinusoid,
)
from sins_align.types import Array

Triple = tuple[float, float, float]

# v_RFU = C_RFU_FLU v_FLU, from (x, y, z)_FLU = (y, -x, z)_RFU.
C_RFU_FLU: Array = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
C_RFU_FLU.setflags(write=False)

_TO_FLU = FixedRotation(C_RFU_FLU)
_PAPER_LEVER_ARM = np.array([4.0, 2.0, 3.0])  # section 4.1, in the axes of the scenario [m]


class Scenario(Protocol):
    """How the attitude moves, before heading offset, turn and motion of the centre."""

    @property
    def name(self) -> str:
        """The name in the truth file."""

    @property
    def paper_axes(self) -> str:
        """The axes in which the paper prints the lever arm: 'b' or 'b2'."""

    @property
    def C_paper_b(self) -> Array:
        """(3, 3) from b (FLU) to `paper_axes`."""

    def rotations(self, phases: Array) -> tuple[RotationStep, ...]:
        """The chain from n to b (FLU); `phases` (3,) are the random phases [rad]."""


class _RightForwardUp:
    """The paper's b where no other axes are defined: x right, y forward, z up."""

    paper_axes = "b"
    C_paper_b = C_RFU_FLU


@dataclass(frozen=True)
class Still(_RightForwardUp):
    """No motion: level, heading north."""

    name: str = "still"

    def rotations(self, phases: Array) -> tuple[RotationStep, ...]:
        """As `Scenario`."""
        return (_TO_FLU,)


@dataclass(frozen=True)
class ThreeAxisSwing(_RightForwardUp):
    """Yaw, pitch and roll each swing: Mu & Fang, section 4.3.

    C_b^p = Rz(psi) Rx(theta) Ry(gamma) with b = RFU, p = ENU, psi counter-clockwise, and
    att_i(t) = attitude_i + amplitude_i sin(2 pi frequency_i t + phase_i). All triples are
    in the order psi, theta, gamma.
    """

    name: str
    attitude_deg: Triple
    amplitude_deg: Triple
    frequency_hz: Triple = (1 / 10, 1 / 8, 1 / 12)

    def rotations(self, phases: Array) -> tuple[RotationStep, ...]:
        """As `Scenario`."""
        psi, theta, gamma = (
            Sinusoid(math.radians(mean), math.radians(amplitude), math.tau * frequency, phase)
            for mean, amplitude, frequency, phase in zip(
                self.attitude_deg, self.amplitude_deg, self.frequency_hz, phases, strict=True
            )
        )
        return (AxisRotation(2, psi), AxisRotation(0, theta), AxisRotation(1, gamma), _TO_FLU)


@dataclass(frozen=True)
class SingleAxisSwing(_RightForwardUp):
    """A swing about one body axis (FLU) alone, around level and heading north.

    Raises
    ------
    ValueError : the axis is not 'x', 'y' or 'z'
    """

    name: str = "single_axis"
    axis: str = "x"
    amplitude_deg: float = 5.0
    frequency_hz: float = 1 / 8

    def __post_init__(self) -> None:
        if self.axis not in ("x", "y", "z"):
            raise ValueError(f"axis: {self.axis!r} is not one of 'x', 'y', 'z'")

    def rotations(self, phases: Array) -> tuple[RotationStep, ...]:
        """As `Scenario`."""
        swing = Sinusoid(
            0.0, math.radians(self.amplitude_deg), math.tau * self.frequency_hz, phases[0]
        )
        return (_TO_FLU, AxisRotation("xyz".index(self.axis), swing))


@dataclass(frozen=True)
class ErectCone:
    """The erect body cones about the vertical: Mu & Fang, section 4.4.

    C_b^p = C_b1^p C_b2^b1 C_b^b2. b1 is fixed to p: pitched up by 90 deg, its y axis points
    up. b2 cones against b1 with the rotation vector cone [sin wt', 0, cos wt'], wt' =
    wt + phase. b is fixed to b2 so that the Euler angles (45, 45, 45) deg are erect.
    """

    name: str = "erect"
    cone_deg: float = 10.0
    frequency_hz: float = 1 / 8
    paper_axes = "b2"

    @property
    def C_b2_b(self) -> Array:
        """(3, 3) from the paper's b (RFU) to its b2: the matrix printed in section 4.4."""
        s = math.sqrt(0.5)
        quarter = 0.5 * s
        C_p_b = np.array(  # Rz(45 deg) Rx(45 deg) Ry(45 deg)
            [
                [0.5 - quarter, -0.5, 0.5 + quarter],
                [0.5 + quarter, 0.5, 0.5 - quarter],
                [-0.5, s, 0.5],
            ]
        )
        C_b1_p = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
        C_b2_b: Array = C_b1_p @ C_p_b
        return C_b2_b

    @property
    def C_paper_b(self) -> Array:
        """(3, 3) from b (FLU) to b2."""
        return self.C_b2_b @ C_RFU_FLU

    def rotations(self, phases: Array) -> tuple[RotationStep, ...]:
        """As `Scenario`."""
        omega = math.tau * self.frequency_hz
        phase = float(phases[0])
        # Ry(a) e_z = [sin a, 0, cos a], so Exp(cone [sin a, 0, cos a]) = Ry(a) Rz(cone) Ry(-a).
        return (
            AxisRotation(0, Linear(math.pi / 2)),
            AxisRotation(1, Linear(phase, omega)),
            AxisRotation(2, Linear(math.radians(self.cone_deg))),
            AxisRotation(1, Linear(-phase, -omega)),
            FixedRotation(self.C_paper_b),
        )


SCENARIOS: Mapping[str, Scenario] = MappingProxyType(
    {
        scenario.name: scenario
        for scenario in (
            ThreeAxisSwing("pitch", (30.0, 55.0, 15.0), (8.0, 7.0, 9.0)),
            ErectCone(),
            ThreeAxisSwing("level", (0.0, 0.0, 0.0), (2.0, 2.0, 2.0)),
            SingleAxisSwing(),
            Still(),
        )
    }
)


def find_scenario(scenario: str | Scenario) -> Scenario:
    """The scenario of that name; one that is no name is returned as it is.

    Raises
    ------
    ValueError : no such name; lists the known ones
    """
    if not isinstance(scenario, str):
        return scenario
    if scenario not in SCENARIOS:
        raise ValueError(f"scenario: no {scenario!r}; known are {', '.join(SCENARIOS)}")
    return SCENARIOS[scenario]


def paper_lever_arm(scenario: Scenario) -> Array:
    """(3,) the paper's lever arm in b (FLU): [4, 2, 3] m in the scenario's paper axes."""
    r_b: Array = scenario.C_paper_b.T @ _PAPER_LEVER_ARM
    return r_b
