"""The odometer of a bag, handed over in step with its IMU."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from sins_align.ros.bags_portions import Part, Portion
from sins_align.ros.odometer import OdometerRecording
from sins_align.types import ImuSamples, OdometerSamples

EARLY_NS = 5_000_000_000

_NS = 1_000_000_000


class Piece(NamedTuple):
    """What a session is given next: first the odometer's samples, then those of the IMU."""

    odometer: OdometerSamples
    imu: ImuSamples


class OdometerFeed:
    """Cuts portions of the IMU where the odometer has to come in between.

    A session takes the odometer some seconds early without any change of its results, and
    late by so much as it waits for it. A sample that came in time is therefore handed over up
    to EARLY_NS early. One that came too late is handed over where it came, as it was live.

    Parameters
    ----------
    recording : all of the bag
    part : what is replayed of the bag
    timeout_s : how long the session waits [s]
    """

    def __init__(self, recording: OdometerRecording, part: Part, timeout_s: float) -> None:
        self._samples = recording.samples
        self._log_time = recording.log_time
        self._part = part
        self._timeout_ns = round(timeout_s * _NS)
        self._next = 0
        self._newest_ns = np.iinfo(np.int64).min  # stamp of the IMU's newest sample
        self._is_cut = False

    def pieces(self, portion: Portion) -> Iterator[Piece]:
        """The portion, with what has to come before and in between."""
        self._cut()
        imu, log_time = portion
        end = int(np.searchsorted(self._log_time, log_time[-1], side="right"))
        odometer = self._samples.select(slice(self._next, end))
        # How many samples of this portion came before each of the odometer's.
        place = np.searchsorted(log_time, self._log_time[self._next : end])
        newest = np.concatenate(([self._newest_ns], np.maximum.accumulate(imu.stamp_ns)))
        late = (newest[place] > odometer.stamp_ns + self._timeout_ns).nonzero()[0]
        edges = np.diff((log_time - log_time[0]) // EARLY_NS).nonzero()[0] + 1
        # Both numbers grow from cut to cut.
        cuts = {*zip(late.tolist(), place[late].tolist(), strict=True)}
        cuts |= {*zip(np.searchsorted(place, edges).tolist(), edges.tolist(), strict=True)}
        for (k, first), (m, last) in pairwise([(0, 0), *sorted(cuts), (len(odometer), len(imu))]):
            yield Piece(odometer.select(slice(k, m)), imu.select(slice(first, last)))
        self._next, self._newest_ns = end, int(max(newest[0], newest[-1]))

    def rest(self) -> OdometerSamples:
        """What came after the last sample of the IMU."""
        self._cut()
        return self._samples.select(slice(self._next, None))

    def _cut(self) -> None:
        """Leave out what is not in the part; it is known since the IMU's first sample."""
        if self._is_cut:
            return
        self._is_cut = True
        inside = self._part.holds(self._samples.stamp_ns)
        self._samples = self._samples.select(inside)
        self._log_time = self._log_time[inside]
