"""What has come from the IMU and is not used yet."""

from __future__ import annotations

import struct
import time

import numpy as np

from sins_align.ros.cdr import ImuDecoder, imu_samples, pack_payloads
from sins_align.types import ImuSamples, InputCounts

SILENT_S = 2.0  # without usable data: an error

_STAMP = (struct.Struct(">iI"), struct.Struct("<iI"))  # by the last bit of the encapsulation
_NS = 1_000_000_000


class ImuInbox:
    """CDR payloads of sensor_msgs/Imu, kept as they come and decoded many at a time.

    frame_id : the first one that there is
    """

    def __init__(self) -> None:
        self.frame_id = ""
        self._payloads: list[bytes] = []
        self._decoder = ImuDecoder()

    def put(self, payload: bytes) -> int:
        """Keep a payload; its stamp [ns]."""
        # At a kilohertz every line here counts.
        self._payloads.append(payload)
        seconds, nanoseconds = _STAMP[payload[1] & 1].unpack_from(payload, 4)
        stamp_ns: int = seconds * _NS + nanoseconds
        return stamp_ns

    def take(self) -> ImuSamples | None:
        """The samples that have come since the last time, None where none have."""
        if not self._payloads:
            return None
        payloads, self._payloads = self._payloads, []
        buffer, offset, size = pack_payloads(payloads)
        rows = self._decoder(buffer, offset, size, np.zeros_like(offset))
        if not self.frame_id and self._decoder.frame_ids:
            self.frame_id = min(self._decoder.frame_ids)
        return imu_samples(rows) if len(rows) else None

    @property
    def frames_warning(self) -> str:
        """What is odd about the frame_ids seen so far, '' if nothing."""
        return self._decoder.frames_warning


class SilenceWatch:
    """For how long no usable IMU sample has come."""

    def __init__(self) -> None:
        self._usable = (0, time.monotonic())  # accepted samples, and since when no more

    def silent_s(self, counts: InputCounts) -> float | None:
        """The time without one [s]; None while they come."""
        now = time.monotonic()
        count = counts.imu_samples
        if count != self._usable[0]:
            self._usable = (count, now)
        silent = now - self._usable[1]
        return silent if count == 0 or silent > SILENT_S else None
