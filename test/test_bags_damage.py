from __future__ import annotations

import contextlib
import io
import random
import shutil
from pathlib import Path

import numpy as np
import pytest
from bags_data import (
    IMU,
    T0,
    assert_equal,
    imu_payloads,
    make_samples,
    read_all,
    write_mcap,
)
from mcap.exceptions import EndOfFile
from mcap.records import Channel, Chunk, ChunkIndex, Message, Schema
from mcap.stream_reader import StreamReader
from rosbags.rosbag1 import Writer as Writer1
from rosbags.typesys import Stores, get_typestore

from sins_align.ros.bags import BagError, open_bag
from sins_align.ros.bags_write import ImuBagWriter

COUNT = 2000
SAMPLES = make_samples(COUNT)


def make_bag(path: Path, compression: str = "zstd", *, crc: bool = True) -> bytes:
    messages = list(zip(SAMPLES.stamp_ns.tolist(), imu_payloads(SAMPLES), strict=True))
    write_mcap(path, messages, compression=compression, crc=crc)
    return path.read_bytes()


def count_by_stream_reader(data: bytes) -> int:
    count = 0
    try:
        for record in StreamReader(io.BytesIO(data)).records:
            assert not isinstance(record, Schema | Channel) or record.id
            count += isinstance(record, Message)
    except EndOfFile:
        pass
    except Exception:  # a record or a frame that is cut; each kind raises an error of its own
        return count
    return count


def fails(*paths: Path) -> str:
    """The line of the error that reading raises."""
    with pytest.raises(BagError) as caught:
        read_all(*paths)
    line = str(caught.value)
    assert line
    assert "\n" not in line
    return line


@pytest.mark.parametrize("part", np.linspace(0.12, 0.999, 12))
@pytest.mark.parametrize("compression", ["none", "zstd", "lz4"])
def test_truncated_mcap_is_used_as_far_as_it_goes(
    tmp_path: Path, compression: str, part: float
) -> None:
    path = tmp_path / "a.mcap"
    data = make_bag(path, compression)
    data = data[: int(part * len(data))]
    path.write_bytes(data)
    have, bag = read_all(path)
    assert len(have) >= count_by_stream_reader(data) > 0
    assert_equal(have, SAMPLES.select(slice(0, len(have))))
    assert bag.report.messages == len(have)
    assert len(bag.warnings) == 1
    assert "a.mcap: an MCAP file which ends without a footer at byte" in bag.warnings[0]


def test_truncated_mcap_in_a_folder(tmp_path: Path) -> None:
    with ImuBagWriter(tmp_path / "bag") as writer:
        writer.write_samples(make_samples(10_000))
    file = tmp_path / "bag" / "bag.mcap"
    file.write_bytes(file.read_bytes()[:2_000_000])
    have, bag = read_all(tmp_path / "bag")
    assert 5000 < len(have) < 6000
    assert len(bag.warnings) == 1


@pytest.mark.parametrize("size", [1, 7, 8, 9, 20, 100, 400, 500])
def test_mcap_cut_before_its_first_message(tmp_path: Path, size: int) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(make_bag(path)[:size])
    assert "a.mcap: no" in fails(path)


@pytest.mark.parametrize("indexed", [True, False])
def test_unchunked_mcap_cut(tmp_path: Path, indexed: bool) -> None:
    path = tmp_path / "a.mcap"
    messages = list(zip(SAMPLES.stamp_ns.tolist(), imu_payloads(SAMPLES), strict=True))
    write_mcap(path, messages, chunked=False, indexed=indexed)
    path.write_bytes(path.read_bytes()[:300_000])
    have, bag = read_all(path)
    assert 700 < len(have) < 1000
    assert_equal(have, SAMPLES.select(slice(0, len(have))))
    assert len(bag.warnings) == 1


@pytest.mark.parametrize("part", [0.3, 0.6, 0.9])
def test_truncated_sqlite3_is_used_as_far_as_it_goes(tmp_path: Path, part: float) -> None:
    with ImuBagWriter(tmp_path / "bag", storage="sqlite3") as writer:
        writer.write_samples(SAMPLES)
    file = tmp_path / "bag" / "bag.db3"
    data = file.read_bytes()
    file.write_bytes(data[: int(part * len(data))])
    have, bag = read_all(tmp_path / "bag")
    assert 0.95 * part * COUNT - 60 < len(have) < COUNT
    assert_equal(have, SAMPLES.select(slice(0, len(have))))
    assert any("cut off" in line for line in bag.warnings)


@pytest.mark.parametrize("size", [50, 100, 4000, 9000])
def test_sqlite3_cut_before_its_first_message(tmp_path: Path, size: int) -> None:
    path = tmp_path / "a.db3"
    with ImuBagWriter(path, storage="sqlite3") as writer:
        writer.write_samples(SAMPLES)
    path.write_bytes(path.read_bytes()[:size])
    assert "a.db3: no" in fails(path)


@pytest.mark.parametrize("compression", ["none", "zstd", "lz4"])
def test_flipped_bytes_cost_the_chunk_where_it_has_a_checksum(
    tmp_path: Path, compression: str
) -> None:
    path = tmp_path / "a.mcap"
    data = bytearray(make_bag(path, compression))
    position = 0
    for record in StreamReader(io.BytesIO(data), emit_chunks=True).records:
        if isinstance(record, Chunk):
            position = data.index(record.data, position)
            if position > len(data) // 2:
                break
    middle = position + 5000
    data[middle : middle + 64] = bytes(byte ^ 0xA5 for byte in data[middle : middle + 64])
    path.write_bytes(data)
    have, bag = read_all(path)
    assert 0 < bag.report.lost < 200
    assert len(have) + bag.report.lost == COUNT
    assert_equal(have, SAMPLES.select(np.isin(SAMPLES.stamp_ns, have.stamp_ns)))
    assert len(bag.warnings) == 1
    assert f"{bag.report.lost} messages" in bag.warnings[0]


def test_damage_between_the_chunks_costs_little(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    data = make_bag(path)
    starts = [record.chunk_start_offset for record in chunk_indexes(data)]
    for offset in (-200, -3, 0, 9 + 8 * 4):  # message index, its end, opcode, name of compression
        damaged = bytearray(data)
        damaged[starts[5] + offset : starts[5] + offset + 64] = b"\xff" * 64
        path.write_bytes(damaged)
        have, bag = read_all(path)
        assert len(have) > COUNT - 300
        assert_equal(have, SAMPLES.select(np.isin(SAMPLES.stamp_ns, have.stamp_ns)))
        assert bag.warnings


def chunk_indexes(data: bytes) -> list[ChunkIndex]:
    records = StreamReader(io.BytesIO(data)).records
    return [record for record in records if isinstance(record, ChunkIndex)]


def test_without_a_checksum_only_the_messages_that_are_hit_are_lost(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    data = bytearray(make_bag(path, "none", crc=False))
    position = data.index(imu_payloads(SAMPLES)[1000])
    data[position - 31 : position - 31 + 64] = bytes(64)  # the head and the begin of a payload
    path.write_bytes(data)
    have, bag = read_all(path)
    assert bag.report.lost == 1
    assert_equal(have, SAMPLES.select(np.r_[0:1000, 1001:COUNT]))
    assert "1 messages lost" in bag.warnings[0]


@pytest.mark.parametrize("storage", ["mcap", "db3", "bag"])
def test_random_damage_never_raises_anything_else(tmp_path: Path, storage: str) -> None:
    rng = random.Random(5)
    path = tmp_path / f"a.{storage}"
    if storage == "bag":
        write_ros1(path)
    else:
        with ImuBagWriter(path, storage="mcap" if storage == "mcap" else "sqlite3") as writer:
            writer.write_samples(SAMPLES.select(slice(0, 300)))
    good = path.read_bytes()
    for _ in range(60):
        data = bytearray(good)
        for _ in range(rng.choice([1, 4])):
            begin = rng.choice([rng.randrange(len(data)), rng.randrange(1000)])
            data[begin : begin + 64] = rng.randbytes(64)
        if rng.random() < 0.5:
            del data[rng.randrange(len(data)) :]
        path.write_bytes(data)
        with contextlib.suppress(BagError):
            read_all(path)


def write_ros1(path: Path) -> None:
    store = get_typestore(Stores.ROS1_NOETIC)
    types = store.types
    vector = types["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=1.0)
    with Writer1(path) as writer:
        topic = writer.add_connection("/imu", IMU, typestore=store)
        for k in range(300):
            stamp = types["builtin_interfaces/msg/Time"](sec=1, nanosec=k)
            message = types[IMU](
                header=types["std_msgs/msg/Header"](seq=k, stamp=stamp, frame_id="imu"),
                orientation=types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
                orientation_covariance=np.zeros(9),
                angular_velocity=vector,
                angular_velocity_covariance=np.zeros(9),
                linear_acceleration=vector,
                linear_acceleration_covariance=np.zeros(9),
            )
            writer.write(topic, T0 + k, store.serialize_ros1(message, IMU))


def test_what_is_no_bag(tmp_path: Path) -> None:
    for name, content in [
        ("text.mcap", b"Dear reader,\n"),
        ("garbage.db3", random.Random(0).randbytes(5000)),
        ("garbage.bag", bytes(range(256))),
        ("zeros.mcap", bytes(1000)),
        ("some.zst", b"\x28\xb5\x2f\xfd" + bytes(100)),
    ]:
        path = tmp_path / name
        path.write_bytes(content)
        with pytest.raises(BagError, match=r"not a bag|is empty"):
            read_all(path)
    (tmp_path / "empty.mcap").touch()
    assert fails(tmp_path / "empty.mcap").endswith("empty.mcap: the file is empty")
    (tmp_path / "sqlite.db3").write_bytes(b"SQLite format 3\0" + bytes(500))
    assert "sqlite.db3: no readable rosbag2 database" in fails(tmp_path / "sqlite.db3")
    (tmp_path / "ros1.bag").write_bytes(b"#ROSBAG V2.0\n\xff\xff\xff")
    assert "ros1.bag: no readable ROS 1 bag" in fails(tmp_path / "ros1.bag")
    with pytest.raises(BagError, match="no path given"):
        open_bag([])


def test_folders_that_are_no_bag(tmp_path: Path) -> None:
    assert fails(tmp_path / "none").endswith("none: no such file or folder")
    folder = tmp_path / "folder"
    folder.mkdir()
    assert "folder: no metadata.yaml" in fails(folder)
    for text in ("", "a: b", "[", "rosbag2_bagfile_information: {}", "\0"):
        (folder / "metadata.yaml").write_text(text)
        assert "metadata.yaml: not the metadata of a bag" in fails(folder)
    (folder / "metadata.yaml").write_text(
        "rosbag2_bagfile_information: {relative_file_paths: [gone.mcap]}"
    )
    assert "gone.mcap: the file is missing" in fails(folder)


def test_bags_without_messages(tmp_path: Path) -> None:
    write_mcap(tmp_path / "a.mcap", [])
    assert "a.mcap: no" in fails(tmp_path / "a.mcap")
    for storage in ("mcap", "sqlite3"):
        with ImuBagWriter(tmp_path / storage, storage=storage) as writer:
            writer.write_samples(SAMPLES.select(slice(0, 0)))
        assert fails(tmp_path / storage).endswith(f"{storage}: no messages on /imu")


def test_one_bad_path_among_several_closes_the_others(tmp_path: Path) -> None:
    make_bag(tmp_path / "a.mcap")
    assert "none: no such" in fails(tmp_path / "a.mcap", tmp_path / "none")
    shutil.rmtree(tmp_path)  # nothing holds the files any more
