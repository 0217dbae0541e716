"""What the three odometer messages say, in bags of all kinds and in ROS's own classes."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags")

from bags_data import STORE, T0
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.typesys import Stores, get_typestore

from sins_align.ros.bags import BagError, open_bag
from sins_align.ros.bags_topics import KINDS, odometer_type
from sins_align.ros.bags_write import BagWriter
from sins_align.ros.odometer import (
    OdometerRow,
    odometer_row,
    odometer_rows,
    odometer_samples,
)
from sins_align.ros.portable_messages import Types, odometer_message, ros_types
from sins_align.types import OdometerSamples

TYPES = KINDS["odom"]
SAMPLES = OdometerSamples(
    T0 + 50_000_000 * np.arange(5), np.array([0.0, 1.5, math.nan, -2.0, 3.0]), np.full(5, 0.25)
)


def expected(message_type: str) -> OdometerSamples:
    known = not message_type.endswith("/TwistStamped")
    return OdometerSamples(
        SAMPLES.stamp_ns, SAMPLES.speed, SAMPLES.variance if known else np.zeros(5)
    )


def assert_same(have: OdometerSamples, want: OdometerSamples) -> None:
    for found, made in zip(have, want, strict=True):
        assert found.dtype == made.dtype
        np.testing.assert_array_equal(found, made)


def all_types() -> list[Types]:
    pytest.importorskip("rclpy")
    return [STORE.types.__getitem__, ros_types]


@pytest.mark.parametrize("message_type", TYPES)
def test_there_and_back(message_type: str) -> None:
    for types in all_types():
        rows = [
            odometer_row(odometer_message(types, message_type, row, "wheel"))
            for row in odometer_rows(SAMPLES)
        ]
        assert_same(odometer_samples(rows), expected(message_type))


@pytest.mark.parametrize("variance", [0.0, -1.0, math.nan, math.inf])
def test_a_variance_that_is_none_is_not_known(variance: float) -> None:
    row = OdometerRow(T0, 1.0, variance)
    message = odometer_message(STORE.types.__getitem__, TYPES[2], row, "")
    assert odometer_row(message) == OdometerRow(T0, 1.0, 0.0)


@pytest.mark.parametrize("message_type", TYPES)
@pytest.mark.parametrize("frame_id", ["", "a", "base", "an/odd name", "Rad-Geber °"])
def test_through_ros_own_serialisation(message_type: str, frame_id: str) -> None:
    serialization = pytest.importorskip("rclpy.serialization")
    row = OdometerRow(T0 + 7, -1.25, 0.5)
    payload = serialization.serialize_message(
        odometer_message(ros_types, message_type, row, frame_id)
    )
    message = STORE.deserialize_cdr(payload, message_type)
    assert message.header.frame_id == frame_id
    known = not message_type.endswith("/TwistStamped")
    assert odometer_row(message) == row._replace(variance=0.5 if known else 0.0)


@pytest.mark.parametrize("message_type", TYPES)
@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
@pytest.mark.parametrize("compression", ["none", "zstd"])
def test_bags(tmp_path: Path, message_type: str, storage: Any, compression: Any) -> None:
    log_time = SAMPLES.stamp_ns + np.array([5, 3, 900_000_000, 4, 2])
    with BagWriter(tmp_path / "bag", storage=storage, compression=compression) as bag:
        bag.write_odometer(SAMPLES, log_time, message_type, topic="/wheel", frame_id="axle")
    with open_bag([tmp_path / "bag"]) as opened:
        recording = opened.read_odometer(opened.find_topic("odom").name)
    came = np.argsort(log_time)
    np.testing.assert_array_equal(recording.log_time, log_time[came])
    assert_same(recording.samples, expected(message_type).select(came))
    assert recording.read_s > 0.0


@pytest.mark.parametrize("message_type", TYPES)
def test_ros1_bags(tmp_path: Path, message_type: str) -> None:
    store = get_typestore(Stores.ROS1_NOETIC)

    def types(name: str) -> Any:
        if name != "std_msgs/msg/Header":
            return store.types[name]
        return lambda **fields: store.types[name](seq=0, **fields)

    with Ros1Writer(tmp_path / "odom.bag") as writer:
        connection = writer.add_connection("/odom", message_type, typestore=store)
        for row in odometer_rows(SAMPLES):
            message = odometer_message(types, message_type, row, "base_link")
            writer.write(connection, row.stamp_ns, store.serialize_ros1(message, message_type))
    with open_bag([tmp_path / "odom.bag"]) as opened:
        recording = opened.read_odometer(opened.find_topic("odom").name)
    assert_same(recording.samples, expected(message_type))


def test_big_endian_and_damage(tmp_path: Path) -> None:
    from bags_data import write_mcap

    kind = TYPES[0]
    message = odometer_message(STORE.types.__getitem__, kind, OdometerRow(T0, 2.5, 0.0), "abc")
    big = bytes(STORE.serialize_cdr(message, kind, little_endian=False))
    assert big[1] == 0
    payloads = [(T0, big), (T0 + 1, big[:40]), (T0 + 2, big)]
    write_mcap(tmp_path / "odom.mcap", payloads, topics=("/odom",), message_type=kind)
    with open_bag([tmp_path / "odom.mcap"]) as opened:
        recording = opened.read_odometer("/odom")
        (warning,) = opened.warnings
    assert recording.samples.speed.tolist() == [2.5, 2.5]
    assert "left out" in warning


def test_a_topic_of_another_type_is_named(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as bag:
        bag.write_odometer(SAMPLES, SAMPLES.stamp_ns, TYPES[0], topic="/wheel")
    with (
        open_bag([tmp_path / "bag"]) as opened,
        pytest.raises(BagError, match=r"no topic /odom; there is /wheel"),
    ):
        opened.read_odometer("/odom")


@pytest.mark.parametrize("message_type", TYPES)
def test_the_parameter_names_the_type(message_type: str) -> None:
    assert odometer_type(message_type.rpartition("/")[2]) == message_type
