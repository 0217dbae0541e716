"""What an odometer's message says, the same for the live node and for a bag."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from sins_align.types import Array, IntArray, OdometerSamples

_NS = 1_000_000_000


class OdometerRow(NamedTuple):
    """One sample, as `OdometerSamples` holds them."""

    stamp_ns: int
    speed: float
    variance: float


class OdometerRecording(NamedTuple):
    """The odometer of a bag, in the order of recording.

    log_time : (N,) when each sample came [ns]
    read_s : wall time spent on reading [s]
    """

    samples: OdometerSamples
    log_time: IntArray
    read_s: float = 0.0


def odometer_row(message: Any) -> OdometerRow:
    """Forward speed of a TwistStamped, TwistWithCovarianceStamped or Odometry.

    The message may be one of ROS or of rosbags. A variance that is no positive number
    stands for one that is not known.
    """
    twist = message.twist
    variance = 0.0
    if hasattr(twist, "covariance"):
        given = float(twist.covariance[0])
        variance = given if given > 0.0 and math.isfinite(given) else 0.0
        twist = twist.twist
    stamp = message.header.stamp
    return OdometerRow(stamp.sec * _NS + stamp.nanosec, float(twist.linear.x), variance)


def odometer_samples(rows: Sequence[OdometerRow]) -> OdometerSamples:
    """The rows as arrays."""
    count = len(rows)
    speed: Array = np.fromiter((row.speed for row in rows), np.float64, count)
    variance: Array = np.fromiter((row.variance for row in rows), np.float64, count)
    stamp_ns: IntArray = np.fromiter((row.stamp_ns for row in rows), np.int64, count)
    return OdometerSamples(stamp_ns, speed, variance)


def odometer_rows(samples: OdometerSamples) -> list[OdometerRow]:
    """The samples one by one."""
    columns = (column.tolist() for column in samples)
    return [OdometerRow(*row) for row in zip(*columns, strict=True)]
