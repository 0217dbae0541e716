"""What the tests of bags share: samples, and bags as other programs write them."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

import numpy as np
from mcap.writer import CompressionType, IndexType, Writer
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from sins_align.ros.bags import Bag, open_bag
from sins_align.ros.cdr import encode_imu
from sins_align.types import ImuSamples

T0 = 1_700_000_000_000_000_000
IMU = "sensor_msgs/msg/Imu"
STORE = get_typestore(Stores.ROS2_JAZZY)


def make_samples(count: int, seed: int = 0, period_ns: int = 10_000_000) -> ImuSamples:
    rng = np.random.default_rng(seed)
    stamp_ns = T0 + period_ns * np.arange(1, count + 1, dtype=np.int64)
    return ImuSamples(stamp_ns, rng.normal(0, 0.01, (3, count)), rng.normal(0, 9, (3, count)))


def join(parts: list[ImuSamples]) -> ImuSamples:
    return ImuSamples(
        np.concatenate([part.stamp_ns for part in parts]),
        np.concatenate([part.w_ib_b for part in parts], axis=1),
        np.concatenate([part.f_ib_b for part in parts], axis=1),
    )


def read_all(*paths: Path, topic: str | None = None, **options: float) -> tuple[ImuSamples, Bag]:
    with open_bag(paths) as bag:
        name = bag.find_topic("imu", topic).name
        return join(list(bag.read_imu(name, **options))), bag


def read_reference(path: Path, topic: str = "/imu", most: int = 10**9) -> ImuSamples:
    """The same by rosbags' own reader and deserialiser."""
    stamps, rates, forces = [], [], []
    with AnyReader([path], default_typestore=STORE) as reader:
        chosen = [entry for entry in reader.connections if entry.topic == topic]
        for entry, _, data in islice(reader.messages(chosen), most):
            message = reader.deserialize(data, entry.msgtype)
            stamp = message.header.stamp
            stamps.append(stamp.sec * 1_000_000_000 + stamp.nanosec)
            for vector, values in (
                (message.angular_velocity, rates),
                (message.linear_acceleration, forces),
            ):
                values.append((vector.x, vector.y, vector.z))
    return ImuSamples(np.array(stamps), np.array(rates).T, np.array(forces).T)


def assert_equal(have: ImuSamples, want: ImuSamples) -> None:
    """Bit for bit."""
    np.testing.assert_array_equal(have.stamp_ns, want.stamp_ns)
    np.testing.assert_array_equal(have.w_ib_b, want.w_ib_b)
    np.testing.assert_array_equal(have.f_ib_b, want.f_ib_b)


def imu_payloads(samples: ImuSamples, frame_id: str = "imu") -> list[bytes]:
    return [bytes(payload) for payload in encode_imu(samples, frame_id)]


def write_mcap(
    path: Path,
    messages: list[tuple[int, bytes]],
    *,
    compression: str = "zstd",
    chunk_size: int = 50_000,
    chunked: bool = True,
    indexed: bool = True,
    crc: bool = True,
    topics: tuple[str, ...] = ("/imu",),
    message_type: str = IMU,
) -> None:
    """A bag by the mcap package; message k goes to topic k modulo their number."""
    definition, _ = STORE.generate_msgdef(message_type, ros_version=2)
    with path.open("wb") as file:
        writer = Writer(
            file,
            chunk_size=chunk_size,
            compression=CompressionType[compression.upper()],
            use_chunking=chunked,
            index_types=IndexType.ALL if indexed else IndexType.NONE,
            enable_crcs=crc,
        )
        writer.start("ros2")
        schema = writer.register_schema(message_type, "ros2msg", definition.encode())
        channels = [writer.register_channel(topic, "cdr", schema) for topic in topics]
        for k, (log_time, payload) in enumerate(messages):
            writer.add_message(channels[k % len(channels)], log_time, payload, log_time)
        writer.finish()
