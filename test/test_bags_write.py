from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from bags_data import IMU, STORE, T0, assert_equal, make_samples, read_all, read_reference
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader

from sins_align.ros.bags import BagError, open_bag
from sins_align.ros.bags_write import BagWriter, ImuBagWriter
from sins_align.ros.cdr import ImuDecoder, encode_imu, pack_payloads
from sins_align.types import Position

DOUBLES = st.lists(st.floats(width=64), min_size=37, max_size=37)


@given(
    st.lists(
        st.tuples(
            st.text(max_size=40).filter(lambda text: "\0" not in text),
            st.integers(-(2**31), 2**31 - 1),
            st.integers(0, 10**9 - 1),
            DOUBLES,
            st.booleans(),
            st.integers(0, 3),
        ),
        min_size=1,
        max_size=4,
    )
)
@settings(max_examples=60, deadline=None)
def test_decoding_equals_the_serialiser_for_any_message(drawn: list) -> None:
    payloads = []
    for frame_id, sec, nanosec, doubles, little_endian, padding in drawn:
        message = _message(frame_id, sec, nanosec, np.array(doubles))
        data = STORE.serialize_cdr(message, IMU, little_endian=little_endian)
        payloads.append(bytes(data) + bytes(padding))
    decoder = ImuDecoder()
    rows = decoder(*pack_payloads(payloads), np.arange(len(drawn)))
    assert decoder.lost == 0
    assert decoder.frame_ids == {entry[0] for entry in drawn}
    for row, (_, sec, nanosec, doubles, _, _) in zip(rows, drawn, strict=True):
        assert row["stamp_ns"] == sec * 1_000_000_000 + nanosec
        assert row["w_ib_b"].tobytes() == np.array(doubles[13:16]).tobytes()
        assert row["f_ib_b"].tobytes() == np.array(doubles[25:28]).tobytes()


def _message(frame_id: str, sec: int, nanosec: int, doubles: np.ndarray) -> object:
    types = STORE.types
    vector = types["geometry_msgs/msg/Vector3"]
    return types[IMU](
        header=types["std_msgs/msg/Header"](
            stamp=types["builtin_interfaces/msg/Time"](sec=sec, nanosec=nanosec),
            frame_id=frame_id,
        ),
        orientation=types["geometry_msgs/msg/Quaternion"](*doubles[:4]),
        orientation_covariance=doubles[4:13],
        angular_velocity=vector(*doubles[13:16]),
        angular_velocity_covariance=doubles[16:25],
        linear_acceleration=vector(*doubles[25:28]),
        linear_acceleration_covariance=doubles[28:37],
    )


@given(st.lists(st.binary(max_size=400), min_size=1, max_size=5))
@settings(max_examples=100, deadline=None)
def test_decoding_takes_any_bytes(payloads: list[bytes]) -> None:
    decoder = ImuDecoder()
    rows = decoder(*pack_payloads(payloads), np.arange(len(payloads)))
    assert len(rows) + decoder.lost == len(payloads)


@pytest.mark.parametrize("frame_id", ["", "imu", "a/long/frame", "θ"])
def test_encoding_equals_the_serialiser(frame_id: str) -> None:
    samples = make_samples(3)
    orientation = np.arange(12.0).reshape(4, 3)
    covariance = np.arange(27.0).reshape(9, 3)
    payloads = encode_imu(samples, frame_id, orientation, covariance)
    unknown = encode_imu(samples, frame_id)
    for k in range(3):
        doubles = np.zeros(37)
        doubles[13:16], doubles[25:28] = samples.w_ib_b[:, k], samples.f_ib_b[:, k]
        sec, nanosec = divmod(int(samples.stamp_ns[k]), 1_000_000_000)
        doubles[4] = -1.0
        message = _message(frame_id, sec, nanosec, doubles)
        assert bytes(STORE.serialize_cdr(message, IMU)) == bytes(unknown[k])
        doubles[:4] = orientation[[1, 2, 3, 0], k]
        doubles[4:13] = covariance[:, k]
        message = _message(frame_id, sec, nanosec, doubles)
        assert bytes(STORE.serialize_cdr(message, IMU)) == bytes(payloads[k])


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
@pytest.mark.parametrize("compression", ["none", "zstd"])
def test_round_trip(tmp_path: Path, storage: str, compression: str) -> None:
    path, samples = tmp_path / "new" / "bag", make_samples(4000)
    with ImuBagWriter(path, "/a/imu", "body", storage, compression) as bag:
        bag.write_fix(Position(0.1, 0.2, 3.0), T0)
        bag.write_samples(samples.select(slice(0, 1500)))
        bag.write_samples(samples.select(slice(1500, None)))
    have, opened = read_all(path)
    assert_equal(have, samples)
    assert opened.report.frame_ids == {"body"}
    assert_equal(read_reference(path, "/a/imu"), samples)
    assert [entry.name for entry in path.parent.iterdir()] == ["bag"]
    if storage == "mcap":
        with (path / "bag.mcap").open("rb") as file:
            messages = list(make_reader(file).iter_messages())
        assert len(messages) == 4001
        assert [schema.name for schema, _, _ in messages[:2]] == ["sensor_msgs/msg/NavSatFix", IMU]
    with open_bag([path]) as bag:
        assert next(bag.read_messages("/a/imu"))[1].orientation_covariance[0] == -1.0


def test_messages_of_any_type(tmp_path: Path) -> None:
    types = STORE.types
    twist = types["geometry_msgs/msg/TwistStamped"](
        header=_message("base", 1, 2, np.zeros(37)).header,
        twist=types["geometry_msgs/msg/Twist"](
            linear=types["geometry_msgs/msg/Vector3"](x=1.5, y=0.0, z=0.0),
            angular=types["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0),
        ),
    )
    with BagWriter(tmp_path / "a.mcap") as writer:
        writer.write("/odom", T0, twist)
        writer.write("/odom", T0 + 1, twist)
    assert (tmp_path / "a.mcap").is_file()
    with open_bag([tmp_path / "a.mcap"]) as bag:
        read = list(bag.read_messages(bag.find_topic("odom").name))
    assert [log_time for log_time, _ in read] == [T0, T0 + 1]
    assert read[0][1].twist.linear.x == 1.5
    assert read[0][1].header.frame_id == "base"


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "bag"
    path.mkdir()
    with pytest.raises(BagError, match=r"bag: exists already and is not overwritten$"):
        ImuBagWriter(path).__enter__()
    assert [entry.name for entry in tmp_path.iterdir()] == ["bag"]


def test_an_error_leaves_nothing_behind(tmp_path: Path) -> None:
    with pytest.raises(AttributeError), BagWriter(tmp_path / "bag") as writer:
        writer.write("/odom", T0, "no message")
    assert list(tmp_path.iterdir()) == []


def test_targets_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(BagError, match=r"file/bag: (Not a directory|File exists)"):
        BagWriter(tmp_path / "file" / "bag").__enter__()
    with pytest.raises(BagError, match="must be a folder"):
        BagWriter(tmp_path / "a.db3", storage="sqlite3", compression="zstd")
    with pytest.raises(BagError, match="in it"):
        BagWriter(tmp_path / "a#b", storage="sqlite3")
