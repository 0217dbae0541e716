"""The IMU samples of a bag in portions: which part was asked for, and what came."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sins_align.ros.cdr import Rows, imu_samples
from sins_align.types import ImuSamples, IntArray

_NS = 1_000_000_000
_BEYOND_NS = 10 * _NS  # messages are never this late: reading may stop


class Portion(NamedTuple):
    """IMU samples in the order of recording, with the log time (N,) of each [ns]."""

    samples: ImuSamples
    log_time: IntArray


@dataclass
class ReadReport:
    """What `Bag.read_imu` has read so far.

    messages : number of samples handed out
    lost : number of messages known to be missing or undecodable where the bag is damaged
    first_stamp_ns, last_stamp_ns : header stamps of the first and the last of them [ns]
    frame_ids : those in the headers
    read_s : wall time spent on reading [s]
    """

    topic: str = ""
    messages: int = 0
    lost: int = 0
    first_stamp_ns: int | None = None
    last_stamp_ns: int | None = None
    frame_ids: set[str] = field(default_factory=set)
    read_s: float = 0.0


class Part:
    """The stamps in [start, start + duration) [s], from the first IMU sample of a bag on.

    Where neither is given that is all of them, also those before the first IMU sample.
    """

    def __init__(self, start_s: float = 0.0, duration_s: float | None = None) -> None:
        self.is_whole = start_s <= 0.0 and duration_s is None
        self._start_ns = round(start_s * _NS)
        self._duration_ns = None if duration_s is None else round(duration_s * _NS)
        self._first_ns: int | None = None

    def holds(self, stamp_ns: IntArray) -> NDArray[np.bool_]:
        """Which of the stamps (N,) are inside; known once an IMU sample has been read."""
        if self.is_whole or self._first_ns is None:
            return np.full(stamp_ns.shape, self.is_whole)
        begin = self._first_ns + self._start_ns
        inside: NDArray[np.bool_] = stamp_ns >= begin
        if self._duration_ns is not None:
            inside &= stamp_ns < begin + self._duration_ns
        return inside

    def select(self, batches: Iterator[Rows]) -> Iterator[Rows]:
        """The rows that are inside."""
        for rows in batches:
            if self.is_whole:
                yield rows
                continue
            stamp = rows["stamp_ns"]
            if self._first_ns is None:
                self._first_ns = int(stamp[0])
            if self._is_beyond(stamp):
                return
            inside = self.holds(stamp)
            if inside.any():
                yield rows[inside]

    def _is_beyond(self, stamp_ns: IntArray) -> bool:
        if self._duration_ns is None or self._first_ns is None:
            return False
        end = self._first_ns + self._start_ns + self._duration_ns
        return bool((stamp_ns > end + _BEYOND_NS).all())


def hand_out(rows: Rows, report: ReadReport) -> Portion:
    """The rows as samples; the report is brought up to date."""
    samples = imu_samples(rows)
    if report.first_stamp_ns is None:
        report.first_stamp_ns = int(samples.stamp_ns[0])
    report.last_stamp_ns = int(samples.stamp_ns[-1])
    report.messages += len(samples)
    return Portion(samples, np.ascontiguousarray(rows["log_time"]))
