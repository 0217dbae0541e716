"""Every reason of `swing_align`, from outside; and that its remedy leads to aligned."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator

import numpy as np
import pytest

pytest.importorskip("rclpy")

from node_harness import SWING
from reason_cases import LOOSE, Case, Nodes, Stage, nodes_in
from reason_drives import Drive, swing

from sins_align.grades import load_grade
from sins_align.simulate import ThreeAxisSwing
from sins_align.types import Array, Position
from sins_align.units import DEG, DEG_PER_H

pytestmark = [pytest.mark.ros, pytest.mark.slow]

G = 9.80665
FINE = {"imu_grade": "fog", "heading_threshold_arcmin": 3.0, "level_threshold_arcsec": 10.0}
COARSE = {"heading_threshold_arcmin": 60.0}
WEAK = ThreeAxisSwing("weak", (0.0, 0.0, 0.0), (0.1, 0.1, 0.1))
NOISE = 50.0


def noisy() -> Drive:
    """Gyros with NOISE times the noise of the declared grade."""
    grade = load_grade("rlg")
    grade = dataclasses.replace(grade, gyro_arw=NOISE * grade.gyro_arw)
    return swing(120.0, seed=3, grade=grade)


def biased() -> Drive:
    """Gyros with fifty times the bias of the declared grade."""
    return swing(100.0).sensed(w=lambda w: w + 0.15 * DEG_PER_H)


def on_its_side(v: Array) -> Array:
    """Turned by 90 deg: gravity lies on the y axis."""
    return np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]) @ v


CASES = (
    Case(
        "as it comes",
        SWING,
        (
            Stage(("levelling",), lambda: swing().part(0.0, 3.5)),
            Stage(("heading_coarse",), lambda: swing().part(3.5, 6.5)),
            Stage(("heading_sigma", "unproven"), lambda: swing().part(6.5, 12.5)),
            Stage(("latitude_unproven",), lambda: swing().part(12.5, 34.5)),
            Stage(("holding",), lambda: swing().part(34.5, 50.5)),
        ),
        lambda: swing().part(50.5),
        # From 43 s on, as the simulation has it: far from either end.
        {"hold_s": 15.0},
    ),
    Case(
        "silence",
        SWING,
        (Stage(("imu_silent",), lambda: swing().part(0.0, 5.0)),),
        lambda: swing().part(5.0),
    ),
    Case(
        "a gap",
        SWING,
        (
            Stage((), lambda: swing().part(0.0, 10.0)),
            Stage(("began_anew",), lambda: swing().part(12.0, 15.0)),
        ),
        lambda: swing().part(15.0),
    ),
    Case(
        "5 Hz",
        SWING,
        (Stage(("slow_imu",), lambda: swing().part(0.0, 10.0).picked(slice(None, None, 4))),),
        lambda: swing().part(10.0),
    ),
    Case(
        "force in g",
        SWING,
        (Stage(("force_in_g",), lambda: swing().part(0.0, 5.0).sensed(f=lambda f: f / G)),),
        lambda: swing().part(5.0),
    ),
    Case(
        "linear acceleration",
        SWING,
        (
            Stage(
                ("gravity_removed",),
                lambda: swing().part(0.0, 5.0).sensed(f=lambda f: f - [[0.0], [0.0], [G]]),
            ),
        ),
        lambda: swing().part(5.0),
    ),
    Case(
        "force of another size",
        SWING,
        (Stage(("force_size",), lambda: swing().part(0.0, 5.0).sensed(f=lambda f: 1.6 * f)),),
        lambda: swing().part(5.0),
    ),
    Case(
        "gyros in degrees",
        SWING,
        (
            Stage(
                ("estimate_broke",),
                lambda: swing(150.0).part(0.0, 20.0).sensed(w=lambda w: w / DEG),
                in_log=True,
            ),
            Stage(
                ("gyro_in_degrees",),
                lambda: swing(150.0).part(20.0, 32.0).sensed(w=lambda w: w / DEG),
            ),
        ),
        lambda: swing(150.0).part(32.0),
    ),
    Case(
        "axes turned",
        SWING,
        (
            Stage(
                ("axes_differ",),
                lambda: swing().part(0.0, 32.0).sensed(w=lambda w: w * [[-1.0], [-1.0], [1.0]]),
            ),
        ),
        lambda: swing().later(35.0),
    ),
    Case(
        "stamps of arrival",
        SWING,
        (Stage(("stamp_jitter",), lambda: swing(10.0, stamp_jitter_s=0.003)),),
        lambda: swing().later(15.0),
    ),
    Case("on its side", SWING, (), lambda: swing().sensed(on_its_side, on_its_side)),
    Case(
        "a small swing",
        SWING,
        (Stage(("swing_weak",), lambda: swing(20.0, scenario=WEAK)),),
        lambda: swing(120.0).later(25.0),
        # The smaller the swing and the larger the noise, the longer it takes.
        {"position_noise_m": 0.02, "latitude_check": "off"},
    ),
    Case(
        "a centre that heaves",
        SWING,
        (Stage(("centre_moves",), lambda: swing(38.5, heave_m=0.05)),),
        lambda: swing().later(45.0),
    ),
    Case(
        "beyond the limits",
        SWING,
        (
            Stage(
                ("heading_limit", "level_limit", "heading_sigma", "level_sigma"),
                lambda: swing(20.0, grade="fog"),
            ),
        ),
        lambda: swing(grade="fog"),
        FINE,
        LOOSE,
    ),
    Case(
        "gyro noise",
        SWING,
        (Stage(("gyro_noisy", "unsteady", "witness_differs"), noisy),),
        noisy,
        COARSE,
        {"gyro_arw_deg_sqrt_h": NOISE * 0.0005},
    ),
    Case(
        "gyro bias", SWING, (Stage(("bias_beyond",), biased),), biased, COARSE,
        {"gyro_bias_deg_h": 0.15},
    ),
    Case(
        "another latitude",
        SWING,
        (Stage(("latitude_differs",), lambda: swing(50.0)),),
        swing,
        {"latitude_deg": 41.0},
        {"latitude_deg": 40.0},
    ),
    Case(
        "another latitude, not to be aligned with",
        SWING,
        (Stage(("latitude_wrong",), lambda: swing(50.0)),),
        swing,
        {"latitude_deg": 41.0, "latitude_check": "fail"},
        {"latitude_deg": 40.0},
    ),
)  # fmt: skip
# By tests of their own.
BESIDE = {"no_imu", "no_position", "imu_refused", "vehicle_moves"}


@pytest.fixture(scope="module")
def nodes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Nodes]:
    with nodes_in(tmp_path_factory.mktemp("swing")) as nodes:
        yield nodes


@pytest.mark.parametrize("number", range(len(CASES)), ids=lambda number: CASES[number].name)
def test_reason_and_remedy(number: int, nodes: Nodes) -> None:
    nodes.check(CASES, number)


def test_nothing_comes_then_stamps_that_stand_still_then_a_fix(nodes: Nodes) -> None:
    live = nodes.start(SWING, LOOSE)
    live.wait_for(Stage(("no_imu", "no_position"), None))
    live.wait_for(
        Stage(("imu_refused", "no_position"), lambda: swing().part(0.0, 3.0).at_one_time())
    )
    live.wait_for(Stage(("no_position",), lambda: swing().part(3.0, 8.0)))
    position = Position(math.radians(40.0), math.radians(116.0), 50.0)
    live.align(swing().part(8.0), live.player(position))


def test_a_vehicle_that_drives_off_and_stops(nodes: Nodes) -> None:
    drive = swing(125.0, drive_m=30.0, drive_start_s=60.0, drive_duration_s=10.0)
    live = nodes.get(SWING)
    live.begin(drive)
    live.align(drive.part(0.0, 60.0))
    live.wait_for(Stage(("vehicle_moves",), lambda: drive.part(60.0, 72.0)))
    live.wait_for(Stage(("began_anew",), lambda: drive.part(72.0, 86.0)))
    live.align(drive.part(86.0))
    assert "began anew: the vehicle had moved" in live.log
