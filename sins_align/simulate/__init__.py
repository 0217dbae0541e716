"""The truth simulator: analytic motion of a swinging base, and sensor error models.

It shares no equations with the estimators (rotation, earth and increments are not imported),
so that one misreading does not sit in both.
"""

from sins_align.simulate.options import SwingOptions
from sins_align.simulate.scenarios import (
    SCENARIOS,
    ErectCone,
    Scenario,
    SingleAxisSwing,
    Still,
    ThreeAxisSwing,
)
from sins_align.simulate.swing import SwingRun, simulate_swing
from sins_align.simulate.truth import SwingTruth

__all__ = [
    "SCENARIOS",
    "ErectCone",
    "Scenario",
    "SingleAxisSwing",
    "Still",
    "SwingOptions",
    "SwingRun",
    "SwingTruth",
    "ThreeAxisSwing",
    "simulate_swing",
]
