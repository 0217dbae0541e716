"""Every reason of `odo_align`, from outside; and that its remedy leads to aligned."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

pytest.importorskip("rclpy")

from node_harness import ODO
from reason_cases import Case, Nodes, Stage, nodes_in
from reason_drives import Drive, vehicle

pytestmark = [pytest.mark.ros, pytest.mark.slow]

FOG = {"imu_grade": "fog"}
TACTICAL = {
    "imu_grade": "tactical", "heading_threshold_arcmin": 120.0, "level_threshold_arcsec": 1000.0
}  # fmt: skip
# No witness: where the azimuth is lost, everything is.
ALONE = {"imu_grade": "rlg", "coarse": "inertial"}


def still() -> Drive:
    return vehicle("static", 50.0)


def laser() -> Drive:
    return vehicle("static", 50.0, grade="rlg")


def ring(duration_s: float = 100.0) -> Drive:
    """The road shakes at up to 2.5 Hz: 20 Hz are few for it."""
    return vehicle("ring", duration_s, rate_hz=50.0)


def tactical_ring() -> Drive:
    return vehicle("ring", 130.0, grade="tactical", seed=3)


def turning_with_a_gap() -> Drive:
    """0.4 s are missing where the vehicle turns: not enough to begin anew."""
    drive = vehicle("figure8", 180.0, grade="rlg", seed=1)
    time_s = (drive.imu.stamp_ns - drive.begin_ns) * 1e-9
    return drive.picked(np.abs(time_s - 88.2) > 0.2)


CASES = (
    Case(
        "no odometer",
        ODO,
        (Stage(("no_odometer",), lambda: still().part(0.0, 10.0).without_odometer),),
        lambda: still().part(10.0),
        FOG,
    ),
    Case(
        "no odometer, and none needed",
        ODO,
        (Stage(("no_odometer",), lambda: still().part(0.0, 10.0).without_odometer),),
        lambda: still().without_odometer,
        FOG,
        {"aiding": "stationary"},
    ),
    Case(
        "it drives, and should stand",
        ODO,
        (Stage(("inconsistent",), lambda: ring().part(0.0, 30.0).without_odometer),),
        ring,
        {**FOG, "aiding": "stationary"},
        {"aiding": "odometer"},
    ),
    Case(
        "standing is not enough",
        ODO,
        (
            Stage(
                ("heading_coarse", "heading_unobservable", "heading_limit"),
                lambda: tactical_ring().part(0.0, 5.5),
            ),
        ),
        lambda: tactical_ring().part(5.5),
        TACTICAL,
    ),
    Case(
        "the azimuth is lost",
        ODO,
        (Stage(("azimuth_lost",), lambda: turning_with_a_gap().part(0.0, 95.0)),),
        lambda: turning_with_a_gap().part(95.0),
        ALONE,
    ),
    Case(
        "an odometer that falls silent",
        ODO,
        (
            Stage((), lambda: ring(150.0).part(0.0, 60.0)),
            Stage(("odometer_silent",), lambda: ring(150.0).part(60.0, 75.0).without_odometer),
        ),
        lambda: ring(150.0).part(75.0, 110.0),
        FOG,
    ),
    Case(
        "another latitude",
        ODO,
        (Stage(("latitude_doubted", "latitude_wrong"), laser),),
        laser,
        {"imu_grade": "rlg", "latitude_deg": 41.0, "latitude_check": "fail"},
        {"latitude_deg": 40.0},
    ),
    Case(
        "at the pole, by a latitude that is wrong",
        ODO,
        (Stage(("at_pole",), lambda: still().part(0.0, 8.0)),),
        still,
        {**FOG, "latitude_deg": 90.0},
        {"latitude_deg": 40.0},
    ),
    # Nothing helps there but to go elsewhere.
    Case(
        "near the pole",
        ODO,
        (Stage(("unobservable_here",), lambda: vehicle("static", 8.0, latitude_deg=89.5)),),
        None,
        {**FOG, "latitude_deg": 89.5},
    ),
    Case(
        "the odometer runs backwards",
        ODO,
        (Stage(("odometer_opposite",), lambda: ring().part(0.0, 40.0).counted(-1.0)),),
        lambda: ring().later(45.0),
        FOG,
    ),
    Case(
        "the odometer gives km/h",
        ODO,
        (Stage(("odometer_scale",), lambda: ring().part(0.0, 40.0).counted(3.6)),),
        lambda: ring().later(45.0),
        FOG,
    ),
)
# By tests of their own.
BESIDE = {"odometer_type"}


@pytest.fixture(scope="module")
def nodes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Nodes]:
    with nodes_in(tmp_path_factory.mktemp("odo")) as nodes:
        yield nodes


@pytest.mark.parametrize("number", range(len(CASES)), ids=lambda number: CASES[number].name)
def test_reason_and_remedy(number: int, nodes: Nodes) -> None:
    nodes.check(CASES, number)


def test_an_odometer_of_another_type(nodes: Nodes) -> None:
    live = nodes.get(ODO, **FOG, odom_type="Odometry")
    publisher = live.announce("TwistStamped")
    live.wait_for(Stage(("odometer_type",), None))
    live.observer.node.destroy_publisher(publisher)
    right = nodes.get(ODO, **FOG)  # TwistStamped is what it takes
    right.begin(still())
    right.align(still())
