"""Several nodes in one graph: namespaces, other names, remapped topics; none minds another."""

from __future__ import annotations

import json
import math
import signal
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")

from node_harness import (
    LATCHED,
    ODO,
    RELIABLE,
    SWING,
    Observer,
    Player,
    arguments,
    diagnostic_values,
    observing,
    running,
    stop,
)
from sensor_msgs.msg import Imu
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from sins_align.simulate import SwingOptions, VehicleOptions, simulate_swing, simulate_vehicle
from sins_align.types import Position

pytestmark = [pytest.mark.ros, pytest.mark.slow]

PLACE = Position(math.radians(40.0))
THRESHOLDS = {"heading_threshold_arcmin": 90.0, "level_threshold_arcsec": 300.0, "hold_s": 2.0}
LEFT, RIGHT = "/vehicle_1/left", "/vehicle_2/right"
SHARED = {"/diagnostics", "/rosout", "/parameter_events"}


def node_words(full_name: str, result: Path, grade: str, **remapped: str) -> list[str]:
    _, namespace, name = full_name.split("/")
    rules = {"__ns": f"/{namespace}", "__node": name, **remapped}
    words = [f"{old}:={new}" for old, new in rules.items()]
    values = {**THRESHOLDS, "imu_grade": grade, "result_file": result}
    return arguments(values) + [part for word in words for part in ("-r", word)]


def diagnostics(observer: Observer, full_name: str) -> list[Any]:
    """Those of one node."""
    seen = observer.received["/diagnostics"]
    return [message for message in seen if message.status[0].hardware_id == full_name[1:]]


def state(observer: Observer, full_name: str) -> str:
    seen = diagnostics(observer, full_name)
    return diagnostic_values(seen[-1])["state"] if seen else ""


def names_of(observer: Observer, full_name: str) -> dict[str, set[str]]:
    """What the graph says the node has by now: it tells by messages of its own, not all at once."""
    namespace, _, name = full_name.rpartition("/")
    node = observer.node
    if (name, namespace) not in node.get_node_names_and_namespaces():
        return {"published": set(), "subscribed": set(), "services": set()}
    found = {
        "published": node.get_publisher_names_and_types_by_node(name, namespace),
        "subscribed": node.get_subscriber_names_and_types_by_node(name, namespace),
        "services": node.get_service_names_and_types_by_node(name, namespace),
    }
    return {kind: {entry[0] for entry in entries} for kind, entries in found.items()}


def check_names(observer: Observer, full_name: str, inputs: set[str]) -> None:
    """Under its own names, and nothing twice but what ROS shares."""
    topics = ("attitude", "misalignment", "aligned", "processed")
    services = ("restart", "save", "set_parameters")
    wanted = {
        "published": {f"{full_name}/{topic}" for topic in topics},
        "subscribed": inputs,
        "services": {f"{full_name}/{service}" for service in services},
    }

    def complete() -> bool:
        found = names_of(observer, full_name)
        return all(names <= found[kind] for kind, names in wanted.items())

    observer.wait(complete, f"the names of {full_name}")
    found = names_of(observer, full_name)
    assert found["subscribed"] - SHARED == inputs
    own = found["published"] - SHARED | found["services"]
    assert all(name.startswith(f"{full_name}/") for name in own), own


def test_two_nodes_in_one_graph(tmp_path: Path) -> None:
    swing = simulate_swing(
        SwingOptions(scenario="pitch", grade="perfect", rate_hz=50.0, duration_s=25.0, seed=1)
    )
    drive = simulate_vehicle(
        VehicleOptions(
            scenario="urban", grade="fog", rate_hz=50.0, odometer_rate_hz=10.0, duration_s=60.0,
            seed=3,
        )
    )  # fmt: skip
    results = {name: tmp_path / f"{name}.json" for name in ("left", "right")}
    left_words = node_words(LEFT, results["left"], "perfect", fix="/gps")
    right_words = node_words(RIGHT, results["right"], "fog", imu="/imu/raw", odom="/wheel/twist")
    with (
        observing() as observer,
        running(SWING, *left_words, log=tmp_path / "left") as left,
        running(ODO, *right_words, log=tmp_path / "right") as right,
    ):
        observer.listen_to_diagnostics()
        for name in (LEFT, RIGHT):
            observer.listen(Imu, f"{name}/attitude", RELIABLE)
            observer.listen(Bool, f"{name}/aligned", LATCHED)
        to_left = Player(observer, LEFT[1:], "/vehicle_1/imu", position=PLACE, fix_topic="/gps")
        to_right = Player(
            observer, RIGHT[1:], "/imu/raw", "/wheel/twist", "TwistStamped", PLACE,
            "/vehicle_2/fix",
        )  # fmt: skip
        check_names(observer, LEFT, {"/vehicle_1/imu", "/gps"})
        check_names(observer, RIGHT, {"/imu/raw", "/wheel/twist", "/vehicle_2/fix"})
        to_left.play(swing.imu)
        observer.wait(lambda: state(observer, LEFT) == "aligned", "left aligned")
        observer.wait(lambda: diagnostics(observer, RIGHT), "right's diagnostics")
        assert state(observer, RIGHT) == "waiting"
        assert not observer.received[f"{RIGHT}/attitude"]
        assert not results["right"].exists()

        half = len(drive.imu) // 2
        middle_ns = drive.imu.stamp_ns[half]
        before = drive.odometer.stamp_ns <= middle_ns
        to_right.play(drive.imu.select(slice(0, half)), drive.odometer.select(before))
        # A service of one is not the other's; then one ends, and the other goes on.
        assert observer.call(Trigger, f"{LEFT}/restart").success
        observer.wait(lambda: state(observer, LEFT) == "waiting", "left waiting")
        assert stop(left, signal.SIGTERM) == 0
        to_right.play(drive.imu.select(slice(half, None)), drive.odometer.select(~before))
        observer.wait(lambda: state(observer, RIGHT) == "aligned", "right aligned")
        flags = [
            [message.data for message in observer.received[f"{name}/aligned"]]
            for name in (LEFT, RIGHT)
        ]
        assert flags == [[False, True, False], [False, True]]
        assert stop(right, signal.SIGTERM) == 0
        titles = {m.status[0].name for m in observer.received["/diagnostics"]}
        assert titles == {"vehicle_1/left: alignment", "vehicle_2/right: alignment"}
    for name, kind, samples in (
        ("left", "swing_align", len(swing.imu)), ("right", "odo_align", len(drive.imu))
    ):  # fmt: skip
        document = json.loads(results[name].read_text())
        assert (document["node"], document["aligned"]) == (kind, True)
        assert document["input"]["imu_samples"] == samples
        text = (tmp_path / name).read_text()
        assert f"[vehicle_{1 if name == 'left' else 2}.{name}]" in text
        assert "Traceback" not in text
