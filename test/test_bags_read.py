from __future__ import annotations

import shutil
import sqlite3
from pathlib import Path

import numpy as np
import pytest
from bags_data import (
    IMU,
    STORE,
    T0,
    assert_equal,
    imu_payloads,
    make_samples,
    read_all,
    read_reference,
    write_mcap,
)
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from sins_align.ros.bags import BagError, open_bag
from sins_align.ros.bags_write import BagWriter, ImuBagWriter
from sins_align.types import ImuSamples, Position

DATA = Path(__file__).parents[2] / "shared" / "data"


def write_imu(path: Path, samples: ImuSamples, storage: str = "mcap", **options: str) -> None:
    with ImuBagWriter(path, storage=storage, **options) as bag:
        bag.write_samples(samples)


@pytest.mark.parametrize(
    ("storage", "mode"),
    [
        ("mcap", CompressionMode.NONE),
        ("mcap", CompressionMode.STORAGE),
        ("mcap", CompressionMode.MESSAGE),
        ("mcap", CompressionMode.FILE),
        ("sqlite3", CompressionMode.NONE),
        ("sqlite3", CompressionMode.MESSAGE),
        ("sqlite3", CompressionMode.FILE),
    ],
)
def test_every_kind_of_rosbag2_folder(tmp_path: Path, storage: str, mode: CompressionMode) -> None:
    path, samples = tmp_path / "bag", make_samples(500)
    writer = Writer(path, version=9, storage_plugin=StoragePlugin[storage.upper()])
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        topic = writer.add_connection("/imu", IMU, typestore=STORE)
        for log_time, payload in zip(samples.stamp_ns, imu_payloads(samples), strict=True):
            writer.write(topic, int(log_time), payload)
    have, bag = read_all(path)
    assert_equal(have, samples)
    assert_equal(have, read_reference(path))
    assert bag.warnings == []
    assert bag.report.messages == 500
    assert (bag.report.first_stamp_ns, bag.report.last_stamp_ns) == (T0 + 10**7, T0 + 5 * 10**9)
    assert bag.report.frame_ids == {"imu"}
    assert bag.report.read_s > 0.0


@pytest.mark.parametrize("compression", ["none", "zstd", "lz4"])
@pytest.mark.parametrize(("chunked", "indexed"), [(True, True), (True, False), (False, False)])
def test_bare_mcap_of_the_mcap_package(
    tmp_path: Path, compression: str, chunked: bool, indexed: bool
) -> None:
    path, samples = tmp_path / "a.mcap", make_samples(5000)
    messages = list(zip(samples.stamp_ns.tolist(), imu_payloads(samples), strict=True))
    write_mcap(path, messages, compression=compression, chunked=chunked, indexed=indexed)
    have, bag = read_all(path)
    assert_equal(have, samples)
    assert bag.warnings == []


@pytest.mark.parametrize(("storage", "suffix"), [("mcap", ".mcap"), ("sqlite3", ".db3")])
def test_bare_file(tmp_path: Path, storage: str, suffix: str) -> None:
    path, samples = tmp_path / f"plain{suffix}", make_samples(100)
    write_imu(path, samples, storage)
    awkward_in_a_uri = path.rename(tmp_path / f"a #1?%20{suffix}")
    assert_equal(read_all(awkward_in_a_uri)[0], samples)


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_split_bag_and_bags_given_in_any_order(tmp_path: Path, storage: str) -> None:
    samples = make_samples(900)
    parts = []
    for k in range(3):
        parts.append(tmp_path / f"part{k}")
        write_imu(parts[k], samples.select(slice(300 * k, 300 * k + 300)), storage)
    assert_equal(read_all(parts[2], parts[0], parts[1])[0], samples)
    split = tmp_path / "split"
    split.mkdir()
    files = [shutil.copy(next(part.glob("part*")), split) for part in parts]
    names = [Path(file).name for file in files]
    (split / "metadata.yaml").write_text(
        f"rosbag2_bagfile_information: {{relative_file_paths: {names}}}"
    )
    assert_equal(read_all(split)[0], samples)


def test_overlapping_bags_are_merged_by_log_time(tmp_path: Path) -> None:
    samples = make_samples(400)
    for name, some in (("even", slice(0, None, 2)), ("odd", slice(1, None, 2))):
        write_imu(tmp_path / name, samples.select(some))
    assert_equal(read_all(tmp_path / "odd", tmp_path / "even")[0], samples)


@pytest.mark.parametrize("spread", [5, 5000])
@pytest.mark.parametrize("indexed", [True, False])
def test_log_time_out_of_order_within_and_across_chunks(
    tmp_path: Path, spread: int, indexed: bool
) -> None:
    samples = make_samples(3000)
    order = np.argsort(np.arange(3000) + np.random.default_rng(1).uniform(0, spread, 3000))
    shuffled = samples.select(order)
    messages = list(zip(shuffled.stamp_ns.tolist(), imu_payloads(shuffled), strict=True))
    write_mcap(tmp_path / "a.mcap", messages, indexed=indexed)
    assert_equal(read_all(tmp_path / "a.mcap")[0], samples)


def test_recorded_order_is_kept_where_header_stamps_go_back(tmp_path: Path) -> None:
    samples = make_samples(50)
    order = np.r_[0:20, 30, 20:30, 31:50]
    payloads = imu_payloads(samples.select(order))
    write_mcap(tmp_path / "a.mcap", [(T0 + k, data) for k, data in enumerate(payloads)])
    assert_equal(read_all(tmp_path / "a.mcap")[0], samples.select(order))


@pytest.mark.parametrize("frame_id", ["", "imu", "vehicle/imu_link"])
def test_ros1_bag(tmp_path: Path, frame_id: str) -> None:
    path, samples, store = tmp_path / "a.bag", make_samples(300), get_typestore(Stores.ROS1_NOETIC)
    with Writer1(path) as writer:
        topic = writer.add_connection("/imu", IMU, typestore=store)
        for k, data in enumerate(imu_payloads(samples, frame_id)):
            message = STORE.deserialize_cdr(data, IMU)
            stamp = message.header.stamp
            message.header = store.types["std_msgs/msg/Header"](
                seq=k, stamp=stamp, frame_id=frame_id
            )
            writer.write(topic, int(samples.stamp_ns[k]), store.serialize_ros1(message, IMU))
    have, bag = read_all(path)
    assert_equal(have, samples)
    assert_equal(have, read_reference(path))
    assert bag.report.frame_ids == {frame_id}
    with open_bag([path]) as opened:
        log_time, message = next(opened.read_messages("/imu"))
    assert (log_time, message.header.frame_id) == (samples.stamp_ns[0], frame_id)


def test_big_endian_odd_and_varying_payloads(tmp_path: Path) -> None:
    samples = make_samples(60)
    payloads = imu_payloads(samples)
    for k in range(0, 60, 3):
        message = STORE.deserialize_cdr(payloads[k], IMU)
        message.header.frame_id = "x" * (k % 17)
        data = STORE.serialize_cdr(message, IMU, little_endian=bool(k % 2))
        payloads[k] = bytes(data) + b"\0" * (k % 4)
    payloads[7] = payloads[7][:100]  # no Imu message
    write_mcap(tmp_path / "a.mcap", [(T0 + k, data) for k, data in enumerate(payloads)])
    have, bag = read_all(tmp_path / "a.mcap")
    assert_equal(have, samples.select(np.r_[0:7, 8:60]))
    assert bag.report.lost == 1
    frames, damage = bag.warnings
    assert frames == "/imu: taken as one IMU, though its frame_ids are '', 'imu' and 16 more"
    assert damage == "/imu: 1 messages are not sensor_msgs/Imu"


def test_sqlite3_without_definitions_as_humble_wrote_it(tmp_path: Path) -> None:
    path, samples = tmp_path / "a.db3", make_samples(50)
    database = sqlite3.connect(path)
    database.executescript(
        "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,"
        " serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL);"
        "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL,"
        " timestamp INTEGER NOT NULL, data BLOB NOT NULL);"
        "CREATE INDEX timestamp_idx ON messages (timestamp ASC);"
        f"INSERT INTO topics VALUES (1, '/imu', '{IMU}', 'cdr', '');"
    )
    database.executemany(
        "INSERT INTO messages (topic_id, timestamp, data) VALUES (1, ?, ?)",
        zip(samples.stamp_ns.tolist(), imu_payloads(samples), strict=True),
    )
    database.commit()
    database.close()
    assert_equal(read_all(path)[0], samples)
    assert_equal(read_reference(path), samples)
    with open_bag([path]) as bag:
        assert next(bag.read_messages("/imu"))[1].header.frame_id == "imu"


def test_part_of_a_bag_by_header_stamp(tmp_path: Path) -> None:
    samples = make_samples(100_000, period_ns=1_000_000)
    write_imu(tmp_path / "bag", samples)
    have, bag = read_all(tmp_path / "bag", start_s=10.0, duration_s=20.0)
    assert_equal(have, samples.select(slice(10_000, 30_000)))
    assert bag.report.messages == 20_000
    with pytest.raises(BagError, match=r"bag: no messages on /imu in the part asked for$"):
        read_all(tmp_path / "bag", start_s=100.0)


def test_portions_and_progress(tmp_path: Path) -> None:
    samples, done = make_samples(120_000, period_ns=1_000_000), []
    write_imu(tmp_path / "bag", samples)
    with open_bag([tmp_path / "bag"]) as bag:
        sizes = [len(part) for part in bag.read_imu("/imu", progress=done.append)]
    assert sum(sizes) == 120_000
    assert max(sizes) < 60_000
    assert done == sorted(done)
    assert 0.0 <= done[0] < 0.1
    assert done[-1] == 1.0


def test_topics_are_found_or_the_error_names_them(tmp_path: Path) -> None:
    samples = make_samples(10)
    with BagWriter(tmp_path / "two") as bag:
        bag.write_imu(samples, topic="/imu/a")
        bag.write_imu(samples, topic="/imu/b")
        bag.write_fix(Position(0.5, -0.25, 12.0), T0)
    with open_bag([tmp_path / "two"]) as bag:
        with pytest.raises(BagError, match=r"two: several topics .*: /imu/a, /imu/b$"):
            bag.find_topic("imu")
        assert bag.find_topic("imu", "imu/b").name == "/imu/b"
        assert bag.find_topic("fix").name == "/fix"
        with pytest.raises(BagError, match=r"no sensor_msgs/Imu on /fix; there is /fix \(s.*Fix\)"):
            bag.find_topic("imu", "/fix")
        with pytest.raises(
            BagError, match=r"no topic of .*TwistStamped .*/imu/a \(sensor_msgs/Imu"
        ):
            bag.find_topic("odom")
        assert bag.find_optional_topic("odom") is None
        assert bag.warnings == []
        assert bag.find_optional_topic("imu") is None
        assert "several topics" in bag.warnings[0]
        with pytest.raises(BagError, match="no topic /nothing"):
            next(bag.read_imu("/nothing"))


def test_first_valid_fix(tmp_path: Path) -> None:
    types = STORE.types
    good = Position(0.5, -0.25, 12.0)
    with BagWriter(tmp_path / "good") as bag:
        bag.write_fix(good, T0)
    with open_bag([tmp_path / "good"]) as opened:
        have = opened.read_fix("/fix")
        assert have is not None
        np.testing.assert_allclose(
            (have.latitude, have.longitude, have.altitude), (0.5, -0.25, 12.0), rtol=1e-15
        )
        fix = next(opened.read_messages("/fix"))[1]
    fix.latitude = float("nan")
    no_status = types["sensor_msgs/msg/NavSatStatus"](status=-1, service=1)
    with BagWriter(tmp_path / "bad") as bag:
        bag.write("/fix", T0, fix)
        bag.write("/fix", T0 + 1, type(fix)(**{**vars(fix), "latitude": 9.0, "status": no_status}))
    with open_bag([tmp_path / "bad"]) as opened:
        assert opened.read_fix("/fix") is None
    with open_bag([tmp_path / "bad", tmp_path / "good"]) as opened:
        assert opened.read_fix("/fix") is not None
    fix.latitude, fix.altitude = 9.0, float("nan")
    with BagWriter(tmp_path / "flat") as bag:
        bag.write("/fix", T0, fix)
    with open_bag([tmp_path / "flat"]) as opened:
        have = opened.read_fix("/fix")
        assert have is not None and have.altitude == 0.0


@pytest.mark.parametrize(
    ("name", "count", "others"), [("lasergyro_a", 54_000, 0), ("kingston_a", 15_000, 1500)]
)
def test_real_recordings(name: str, count: int, others: int) -> None:
    path = DATA / name
    if not path.exists():
        pytest.skip(f"the real recordings are not at {DATA}")
    have, bag = read_all(path)
    assert bag.report.messages == count
    assert bag.warnings == []
    reference = read_reference(path, "/imu/data_raw", 15_000)
    assert_equal(have.select(slice(0, 15_000)), reference)
    with open_bag([path]) as opened:
        fix = opened.read_fix(opened.find_topic("fix").name)
        assert fix is not None
        assert 0.55 < fix.latitude < 0.8
        if others:
            twists = list(opened.read_messages(opened.find_topic("odom").name))
            assert len(twists) == others
            assert np.isfinite(twists[-1][1].twist.twist.linear.x)
