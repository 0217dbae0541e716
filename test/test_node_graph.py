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
    THRESHOLDS,
    Observer,
    Player,
    arguments,
    diagnostic_values,
    observing,
    pitching,
    running,
    stop,
    urban_drive,
)
from sensor_msgs.msg import Imu
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from sins_align.types import Position

pytestmark = [pytest.mark.ros, pytest.mark.slow]

PLACE = Position(math.radians(40.0))
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


def listen(observer: Observer) -> None:
    observer.listen_to_diagnostics()
    for name in (LEFT, RIGHT):
        observer.listen(Imu, f"{name}/attitude", RELIABLE)
        observer.listen(Bool, f"{name}/aligned", LATCHED)


def check_right_has_got_nothing(observer: Observer, result: Path) -> None:
    observer.wait(lambda: diagnostics(observer, RIGHT), "right's diagnostics")
    assert state(observer, RIGHT) == "waiting"
    assert not observer.received[f"{RIGHT}/attitude"]
    assert not result.exists()


def check_published(observer: Observer) -> None:
    """What has come of both: left aligned and restarted, right aligned."""
    for name, flags in ((LEFT, [False, True, False]), (RIGHT, [False, True])):
        assert [message.data for message in observer.received[f"{name}/aligned"]] == flags
    titles = {message.status[0].name for message in observer.received["/diagnostics"]}
    assert titles == {"vehicle_1/left: alignment", "vehicle_2/right: alignment"}


def check_written(folder: Path, full_name: str, node: str, samples: int) -> None:
    """Its result, and its log."""
    _, namespace, name = full_name.split("/")
    document = json.loads((folder / f"{name}.json").read_text())
    assert (document["node"], document["aligned"]) == (node, True)
    assert document["input"]["imu_samples"] == samples
    text = (folder / name).read_text()
    assert f"[{namespace}.{name}]" in text
    assert "Traceback" not in text


def test_two_nodes_in_one_graph(tmp_path: Path) -> None:
    imu, drive = pitching(25.0), urban_drive()
    half = len(drive.imu) // 2
    before = drive.odometer.stamp_ns <= drive.imu.stamp_ns[half]
    left_result, right_result = tmp_path / "left.json", tmp_path / "right.json"
    left_words = node_words(LEFT, left_result, "perfect", fix="/gps")
    right_words = node_words(RIGHT, right_result, "fog", imu="/imu/raw", odom="/wheel/twist")
    with (
        observing() as observer,
        running(SWING, *left_words, log=tmp_path / "left") as left,
        running(ODO, *right_words, log=tmp_path / "right") as right,
    ):
        listen(observer)
        to_left = Player(observer, LEFT[1:], "/vehicle_1/imu", position=PLACE, fix_topic="/gps")
        to_right = Player(
            observer, RIGHT[1:], "/imu/raw", "/wheel/twist", "TwistStamped", PLACE,
            "/vehicle_2/fix",
        )  # fmt: skip
        check_names(observer, LEFT, {"/vehicle_1/imu", "/gps"})
        check_names(observer, RIGHT, {"/imu/raw", "/wheel/twist", "/vehicle_2/fix"})
        to_left.play(imu)
        observer.wait(lambda: state(observer, LEFT) == "aligned", "left aligned")
        check_right_has_got_nothing(observer, right_result)
        to_right.play(drive.imu.select(slice(0, half)), drive.odometer.select(before))
        # A service of one is not the other's; then one ends, and the other goes on.
        assert observer.call(Trigger, f"{LEFT}/restart").success
        observer.wait(lambda: state(observer, LEFT) == "waiting", "left waiting")
        assert stop(left, signal.SIGTERM) == 0
        to_right.play(drive.imu.select(slice(half, None)), drive.odometer.select(~before))
        observer.wait(lambda: state(observer, RIGHT) == "aligned", "right aligned")
        assert stop(right, signal.SIGTERM) == 0
        check_published(observer)
    check_written(tmp_path, LEFT, "swing_align", len(imu))
    check_written(tmp_path, RIGHT, "odo_align", len(drive.imu))
