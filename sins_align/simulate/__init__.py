"""The truth simulator: analytic motion of a swinging base or a vehicle, and sensor models.

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
from sins_align.simulate.vehicle import VehicleRun, simulate_vehicle
from sins_align.simulate.vehicle_options import VehicleOptions
from sins_align.simulate.vehicle_route import VEHICLE_SCENARIOS
from sins_align.simulate.vehicle_truth import VehicleTruth

__all__ = [
    "SCENARIOS",
    "VEHICLE_SCENARIOS",
    "ErectCone",
    "Scenario",
    "SingleAxisSwing",
    "Still",
    "SwingOptions",
    "SwingRun",
    "SwingTruth",
    "ThreeAxisSwing",
    "VehicleOptions",
    "VehicleRun",
    "VehicleTruth",
    "simulate_swing",
    "simulate_vehicle",
]
