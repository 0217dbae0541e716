"""sensor_msgs/Imu payloads to arrays and back, many messages at a time.

Both wire formats begin alike: four bytes, sec, nanosec, the length of frame_id, frame_id.

CDR     the four bytes say which encapsulation it is; frame_id ends in a NUL, which counts.
        What follows is aligned to 8 bytes, counted from behind the encapsulation: the
        doubles of the message begin at 4 + ((12 + length + 7) & ~7).
ROS 1   the four bytes are header.seq; nothing is aligned: the doubles begin at 16 + length.

The 37 doubles are orientation (x, y, z, w), its covariance (9), angular velocity (3), its
covariance (9), linear acceleration (3), its covariance (9).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from sins_align.types import Array, ImuSamples, IntArray

Bytes = NDArray[np.uint8]
Rows = NDArray[np.void]
"""One message a row; the field `log_time` [ns] is always there."""

IMU_ROW = np.dtype(
    [("log_time", "<i8"), ("stamp_ns", "<i8"), ("w_ib_b", "<f8", (3,)), ("f_ib_b", "<f8", (3,))]
)
RAW_ROW = np.dtype([("log_time", "<i8"), ("payload", "O")])

_NS = 1_000_000_000
_HEAD_SIZE = 16
_DOUBLES_SIZE = 37 * 8
_RATE_OFFSET = 13 * 8
_RATE_TO_FORCE = 15  # doubles from the first of the rate to the last of the specific force
_MAX_PADDING = 3  # bytes some serialisers add to fill the last word


class Decoder(Protocol):
    """Turns payloads into rows; what it cannot take is left out and counted.

    lost : number of messages that were in the recording and are not in the rows
    """

    lost: int

    def __call__(self, buffer: Bytes, offset: IntArray, size: IntArray, log_time: IntArray) -> Rows:
        """Rows of the payloads at `offset` in `buffer`, of `size` bytes each."""


class RawDecoder:
    """Keeps the payloads as `bytes`, for types that are deserialised one by one."""

    def __init__(self) -> None:
        self.lost = 0

    def __call__(self, buffer: Bytes, offset: IntArray, size: IntArray, log_time: IntArray) -> Rows:
        """Rows of dtype `RAW_ROW`."""
        rows = np.empty(len(offset), RAW_ROW)
        rows["log_time"] = log_time
        data = memoryview(buffer)
        for k, (begin, length) in enumerate(zip(offset.tolist(), size.tolist(), strict=True)):
            rows["payload"][k] = bytes(data[begin : begin + length])
        return rows


class ImuDecoder:
    """Decodes sensor_msgs/Imu with numpy, in groups of one byte order and one frame_id length.

    lost : messages that are not in the rows, for whatever reason
    undecodable : of them those that are no Imu message
    frame_ids : those seen so far
    """

    def __init__(self, *, ros1: bool = False) -> None:
        self.lost = 0
        self.undecodable = 0
        self.frame_ids: set[str] = set()
        self._ros1 = ros1

    @property
    def frames_warning(self) -> str:
        """What is odd about the frame_ids seen so far, '' if nothing."""
        if len(self.frame_ids) < 2:
            return ""
        first, second, *more = sorted(self.frame_ids)
        others = f" and {len(more)} more" if more else ""
        return f"taken as one IMU, though its frame_ids are {first!r}, {second!r}{others}"

    def __call__(self, buffer: Bytes, offset: IntArray, size: IntArray, log_time: IntArray) -> Rows:
        """Rows of dtype `IMU_ROW`, in the order given."""
        count = len(offset)
        rows = np.empty(count, IMU_ROW)
        rows["log_time"] = log_time
        decoded = np.zeros(count, np.bool_)
        candidates = np.flatnonzero(size >= _HEAD_SIZE + _DOUBLES_SIZE)
        if candidates.size:
            head = _gather(buffer, offset[candidates], _HEAD_SIZE)
            kind = np.zeros(len(head), np.int64) if self._ros1 else _byte_order(head)
            for big in (False, True):
                some = kind == big
                if some.any():
                    words = head[some].view(">u4" if big else "<u4").astype(np.int64)
                    self._decode(buffer, offset, size, rows, decoded, candidates[some], words, big)
        if decoded.all():
            return rows
        undecodable = int(count - decoded.sum())
        self.undecodable += undecodable
        self.lost += undecodable
        return rows[decoded]

    def _decode(
        self,
        buffer: Bytes,
        offset: IntArray,
        size: IntArray,
        rows: Rows,
        decoded: NDArray[np.bool_],
        index: IntArray,
        words: IntArray,
        big: bool,
    ) -> None:
        """Fill `rows[index]`, messages of one byte order, from their four leading words."""
        seconds = words[:, 1] if self._ros1 else words[:, 1].astype(np.int32).astype(np.int64)
        lengths = words[:, 3]
        same = bool((lengths == lengths[0]).all())
        for length in lengths[:1].tolist() if same else np.unique(lengths).tolist():
            begin = doubles_offset(length, ros1=self._ros1)
            spare = size[index] - (begin + _DOUBLES_SIZE)
            good = (lengths == length) & (spare >= 0) & (spare <= _MAX_PADDING)
            if not good.any():
                continue
            chosen = index[good]
            block = _gather(buffer, offset[chosen] + begin + _RATE_OFFSET, 8 * _RATE_TO_FORCE)
            values = block.view(">f8" if big else "<f8")
            rows["stamp_ns"][chosen] = seconds[good] * _NS + words[good, 2]
            rows["w_ib_b"][chosen] = values[:, :3]
            rows["f_ib_b"][chosen] = values[:, 12:]
            decoded[chosen] = True
            self._note_frame(buffer, offset[chosen] + _HEAD_SIZE, length)

    def _note_frame(self, buffer: Bytes, offset: IntArray, length: int) -> None:
        frames = _gather(buffer, offset, length) if length else np.zeros((1, 0), np.uint8)
        distinct = frames[:1] if (frames == frames[0]).all() else np.unique(frames, axis=0)
        for frame in distinct:
            self.frame_ids.add(frame.tobytes().rstrip(b"\0").decode(errors="replace"))


def imu_samples(rows: Rows) -> ImuSamples:
    """The samples in rows of dtype `IMU_ROW`."""
    return ImuSamples(
        np.ascontiguousarray(rows["stamp_ns"]),
        np.ascontiguousarray(rows["w_ib_b"].T),
        np.ascontiguousarray(rows["f_ib_b"].T),
    )


def doubles_offset(length: int, *, ros1: bool = False) -> int:
    """Where the 37 doubles of an Imu payload begin [bytes].

    length : of frame_id as the payload states it, with its NUL in CDR
    """
    return _HEAD_SIZE + length if ros1 else 4 + ((12 + length + 7) & ~7)


def pack_payloads(payloads: Sequence[bytes]) -> tuple[Bytes, IntArray, IntArray]:
    """One buffer of all payloads, with the offset and the size of each [bytes]."""
    size = np.fromiter(map(len, payloads), np.int64, len(payloads))
    return np.frombuffer(b"".join(payloads), np.uint8), np.cumsum(size) - size, size


def encode_imu(
    samples: ImuSamples,
    frame_id: str,
    orientation: Array | None = None,
    orientation_covariance: Array | None = None,
) -> list[memoryview]:
    """The CDR payloads of samples, little endian.

    Parameters
    ----------
    samples : N samples
    frame_id : of all of them
    orientation : (4, N) unit quaternions, scalar first. None: unknown, and
        `orientation_covariance[0]` is -1, as the message's definition asks for.
    orientation_covariance : (9, N) [rad^2], zero (unknown) if not given
    """
    name = frame_id.encode() + b"\0"
    begin = doubles_offset(len(name))
    layout = np.dtype(
        {
            "names": ["encapsulation", "time", "length", "frame_id", "doubles"],
            "formats": ["4u1", "2<u4", "<u4", f"V{len(name)}", "37<f8"],
            "offsets": [0, 4, 12, 16, begin],
            "itemsize": begin + _DOUBLES_SIZE,
        }
    )
    messages = np.zeros(len(samples), layout)
    messages["encapsulation"] = (0, 1, 0, 0)
    messages["time"][:, 0], messages["time"][:, 1] = np.divmod(samples.stamp_ns, _NS)
    messages["length"] = len(name)
    messages["frame_id"] = np.void(name)
    doubles = messages["doubles"]
    if orientation is None:
        doubles[:, 4] = -1.0
    else:
        doubles[:, 0:4] = orientation[[1, 2, 3, 0]].T
        if orientation_covariance is not None:
            doubles[:, 4:13] = orientation_covariance.T
    doubles[:, 13:16] = samples.w_ib_b.T
    doubles[:, 25:28] = samples.f_ib_b.T
    data = memoryview(messages.tobytes())
    return [data[k : k + layout.itemsize] for k in range(0, len(data), layout.itemsize)]


def _gather(buffer: Bytes, offset: IntArray, length: int) -> Bytes:
    """(N, length) bytes that begin at each offset."""
    gathered: Bytes = sliding_window_view(buffer, length)[offset]
    return gathered


def _byte_order(head: Bytes) -> IntArray:
    """0 little endian, 1 big endian, -1 an encapsulation that is not plain CDR."""
    plain = (head[:, 0] == 0) & (head[:, 1] <= 1)
    return np.where(plain, 1 - head[:, 1].astype(np.int64), -1)
