"""Write bags: IMU samples fast, other messages one by one.

A bag appears under its name when it is complete, or not at all. A path that ends in .mcap
or .db3 becomes a bare file, any other a rosbag2 folder.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from sins_align.ros.bags_merge import BagError
from sins_align.ros.cdr import encode_imu
from sins_align.ros.odometer import odometer_rows
from sins_align.ros.portable_messages import odometer_message
from sins_align.types import Array, ImuSamples, IntArray, OdometerSamples, Position

if TYPE_CHECKING:
    from rosbags.interfaces import Connection
    from rosbags.rosbag2 import Writer
    from rosbags.typesys.store import Typestore

Storage = Literal["mcap", "sqlite3"]
Compression = Literal["none", "zstd"]

_SUFFIX = {"mcap": ".mcap", "sqlite3": ".db3"}
_IMU = "sensor_msgs/msg/Imu"


class BagWriter:
    """Writes messages of the Jazzy types to a bag, by their header stamp or another time.

    Used as a context; when the context ends with an error nothing is left behind.

    Parameters
    ----------
    path : of the bag, which must not exist yet; folders above it are made
    storage : "mcap" or "sqlite3"
    compression : "none" or "zstd": MCAP by chunks, sqlite3 the whole file

    Raises
    ------
    BagError : the target exists, or cannot be written
    """

    def __init__(
        self, path: Path, *, storage: Storage = "mcap", compression: Compression = "none"
    ) -> None:
        self.path = path
        self._storage = storage
        self._bare = path.suffix == _SUFFIX[storage]
        if self._bare and storage == "sqlite3" and compression != "none":
            raise BagError(path, "a compressed sqlite3 bag must be a folder")
        if storage == "sqlite3" and set("?#%") & set(str(path.absolute())):
            raise BagError(path, "sqlite3 bags cannot be written to a path with ?, # or % in it")
        self._compressed = compression == "zstd"
        self._connections: dict[tuple[str, str], Connection] = {}
        self._folder: Path | None = None

    def __enter__(self) -> BagWriter:
        from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
        from rosbags.typesys import Stores, get_typestore

        self._store: Typestore = get_typestore(Stores.ROS2_JAZZY)
        with _as_bag_error(self.path):
            if self.path.exists():
                raise BagError(self.path, "exists already and is not overwritten")
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._folder = Path(
                tempfile.mkdtemp(prefix=f".{self.path.name}.", dir=self.path.parent)
            )
            # The storage file is named after the folder, which so has its final name already.
            name = self.path.stem if self._bare else self.path.name
            plugin = StoragePlugin.MCAP if self._storage == "mcap" else StoragePlugin.SQLITE3
            self._writer: Writer = Writer(self._folder / name, version=9, storage_plugin=plugin)
            if self._compressed:
                in_chunks = self._storage == "mcap"
                mode = CompressionMode.STORAGE if in_chunks else CompressionMode.FILE
                self._writer.set_compression(mode, CompressionFormat.ZSTD)
            self._writer.open()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        assert self._folder is not None
        try:
            with _as_bag_error(self.path):
                if kind is not None:
                    self._writer.abort()
                    return
                self._writer.close()
                made = self._writer.path
                if self._bare:
                    made = made / f"{made.name}{_SUFFIX[self._storage]}"
                if self.path.exists():
                    raise BagError(self.path, "exists already and is not overwritten")
                made.rename(self.path)
        finally:
            shutil.rmtree(self._folder, ignore_errors=True)

    def write(self, topic: str, log_time: int, message: Any) -> None:
        """Write one message, an instance of a type of `rosbags` [ns]."""
        kind = str(message.__msgtype__)
        payload = self._store.serialize_cdr(message, kind)
        self._put(self._connection(topic, kind), [log_time], [payload])

    def write_imu(
        self,
        samples: ImuSamples,
        *,
        topic: str = "/imu",
        frame_id: str = "imu",
        orientation: Array | None = None,
        orientation_covariance: Array | None = None,
    ) -> None:
        """Write samples as sensor_msgs/Imu, logged at their stamps; see `cdr.encode_imu`."""
        payloads = encode_imu(samples, frame_id, orientation, orientation_covariance)
        self._put(self._connection(topic, _IMU), samples.stamp_ns.tolist(), payloads)

    def write_fix(
        self, position: Position, stamp_ns: int, *, topic: str = "/fix", frame_id: str = "gnss"
    ) -> None:
        """Write a position as sensor_msgs/NavSatFix of unknown covariance."""
        types = self._store.types
        seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
        stamp = types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds)
        fix = types["sensor_msgs/msg/NavSatFix"](
            header=types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame_id),
            status=types["sensor_msgs/msg/NavSatStatus"](status=0, service=1),
            latitude=float(np.degrees(position.latitude)),
            longitude=float(np.degrees(position.longitude)),
            altitude=position.altitude,
            position_covariance=np.zeros(9),
            position_covariance_type=0,
        )
        self.write(topic, stamp_ns, fix)

    def write_odometer(
        self,
        samples: OdometerSamples,
        log_time: IntArray,
        message_type: str,
        *,
        topic: str = "/odom",
        frame_id: str = "base_link",
    ) -> None:
        """Write samples, logged at (N,) [ns], as a message type of kind "odom"."""
        types = self._store.types.__getitem__
        for time, row in zip(log_time.tolist(), odometer_rows(samples), strict=True):
            self.write(topic, time, odometer_message(types, message_type, row, frame_id))

    def _connection(self, topic: str, kind: str) -> Connection:
        key = (topic, kind)
        if key not in self._connections:
            connection = self._writer.add_connection(topic, kind, typestore=self._store)
            self._connections[key] = connection
        return self._connections[key]

    def _put(
        self, connection: Connection, log_times: Iterable[int], payloads: Iterable[memoryview]
    ) -> None:
        with _as_bag_error(self.path):
            for log_time, payload in zip(log_times, payloads, strict=True):
                self._writer.write(connection, log_time, payload)


class ImuBagWriter(BagWriter):
    """A bag of one IMU and, at will, a position fix; otherwise a `BagWriter`.

    topic, frame_id : of the IMU
    """

    def __init__(
        self,
        path: Path,
        topic: str = "/imu",
        frame_id: str = "imu",
        storage: Storage = "mcap",
        compression: Compression = "none",
    ) -> None:
        super().__init__(path, storage=storage, compression=compression)
        self._topic = topic
        self._frame_id = frame_id

    def __enter__(self) -> ImuBagWriter:
        super().__enter__()
        return self

    def write_samples(self, samples: ImuSamples) -> None:
        """Write samples, logged at their stamps; the orientation is marked as unknown."""
        self.write_imu(samples, topic=self._topic, frame_id=self._frame_id)


@contextmanager
def _as_bag_error(path: Path) -> Iterator[None]:
    """Turn what writing raises into a BagError on `path`."""
    import sqlite3

    from rosbags.rosbag2 import WriterError

    try:
        yield
    except OSError as error:
        raise BagError(path, error.strerror or error) from error
    except (WriterError, sqlite3.Error) as error:
        raise BagError(path, error) from error
