"""What all kinds of bag files share: errors, topics, and reading in the order of time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np

from sins_align.ros.cdr import Bytes, Decoder, Rows, pack_payloads
from sins_align.types import IntArray


class BagError(ValueError):
    """A bag that cannot be read or written. Its text is one line that says where and what."""

    def __init__(self, where: object, what: object) -> None:
        super().__init__(" ".join(f"{where}: {what}".split()))


class Topic(NamedTuple):
    """A topic of a bag.

    type : as in ROS 2, "sensor_msgs/msg/Imu", for ROS 1 bags too
    ros1 : the payloads are serialised as in ROS 1
    definition : of the message type, with that of its fields; empty when the bag has none
    """

    name: str
    type: str
    ros1: bool = False
    definition: str = ""


class Unit(NamedTuple):
    """A stretch of a recording: rows in batches, each in the order of log time.

    start : no row has an earlier log time [ns]
    """

    start: int
    read: Callable[[], Iterator[Rows]]


class Source(Protocol):
    """One storage file.

    start, end : log time of its first and last message [ns]; both 0 when there is none
    """

    path: Path
    topics: list[Topic]
    start: int
    end: int

    def units(self, topic: str, decoder: Decoder) -> list[Unit]:
        """The stretches that may hold messages of `topic`; none where there is none."""

    def close(self) -> None:
        """Close the file."""


class Warnings(list[str]):
    """What was wrong with the bags and did not prevent reading. Each line comes once."""

    def note(self, where: object, what: str) -> None:
        """Add a line."""
        line = f"{where}: {what}"
        if line not in self:
            self.append(line)


class ZstdMessages:
    """A decoder for bags of which every message is compressed by itself."""

    def __init__(self, decoder: Decoder) -> None:
        self._decoder = decoder
        self.lost = 0

    def __call__(self, buffer: Bytes, offset: IntArray, size: IntArray, log_time: IntArray) -> Rows:
        """Rows of the decompressed payloads."""
        import zstandard

        decompressor = zstandard.ZstdDecompressor()
        data = memoryview(buffer)
        payloads: list[bytes] = []
        kept: list[int] = []
        for k, (begin, length) in enumerate(zip(offset.tolist(), size.tolist(), strict=True)):
            try:
                payload = decompressor.decompressobj().decompress(data[begin : begin + length])
            except zstandard.ZstdError:
                self._decoder.lost += 1
                continue
            payloads.append(payload)
            kept.append(k)
        return self._decoder(*pack_payloads(payloads), log_time[kept])


def merge(units: Sequence[Unit]) -> Iterator[Rows]:
    """Rows of all units in the order of log time; equal times in the order of the units.

    A unit is opened when its turn has come, so that memory holds one batch of each of those
    that overlap.
    """
    waiting = sorted(units, key=lambda unit: unit.start, reverse=True)
    active: list[tuple[Rows, Iterator[Rows]]] = []
    while waiting or active:
        if not active:
            _open(waiting.pop(), active)
            continue
        bound = min(int(rows["log_time"][-1]) for rows, _ in active)
        if waiting and waiting[-1].start <= bound:
            _open(waiting.pop(), active)
            continue
        parts: list[Rows] = []
        remaining: list[tuple[Rows, Iterator[Rows]]] = []
        for rows, batches in active:
            ready = int(np.searchsorted(rows["log_time"], bound, side="right"))
            parts.append(rows[:ready])
            rest = rows[ready:] if ready < len(rows) else _next_batch(batches)
            if rest is not None:
                remaining.append((rest, batches))
        active = remaining
        yield parts[0] if len(parts) == 1 else _sorted(np.concatenate(parts))


def sort_rows(rows: Rows) -> Rows:
    """`rows` in the order of log time, as they are if that is their order."""
    return rows if (np.diff(rows["log_time"]) >= 0).all() else _sorted(rows)


def _sorted(rows: Rows) -> Rows:
    return rows[np.argsort(rows["log_time"], kind="stable")]


def _open(unit: Unit, active: list[tuple[Rows, Iterator[Rows]]]) -> None:
    batches = unit.read()
    rows = _next_batch(batches)
    if rows is not None:
        active.append((rows, batches))


def _next_batch(batches: Iterator[Rows]) -> Rows | None:
    return next((rows for rows in batches if len(rows)), None)
