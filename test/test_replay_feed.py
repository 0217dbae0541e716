"""In which order a replay hands over the IMU and the odometer."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("rosbags")

from bags_data import T0, make_samples

from sins_align.ros.bags_portions import Part, Portion
from sins_align.ros.cdr import IMU_ROW
from sins_align.ros.odometer import OdometerRecording
from sins_align.ros.replay_feed import OdometerFeed
from sins_align.types import OdometerSamples

MS = 1_000_000
SECOND = 1_000_000_000


def recording(stamps_ms: list[int], came_ms: list[int]) -> OdometerRecording:
    count = len(stamps_ms)
    samples = OdometerSamples(
        T0 + MS * np.array(stamps_ms), np.arange(count, dtype=float), np.zeros(count)
    )
    return OdometerRecording(samples, T0 + MS * np.array(came_ms))


def portions(count: int, size: int) -> list[Portion]:
    """IMU samples every 10 ms from T0 + 10 ms on, logged at their stamps."""
    imu = make_samples(count)
    cuts = [slice(k, k + size) for k in range(0, count, size)]
    return [Portion(imu.select(cut), imu.stamp_ns[cut]) for cut in cuts]


def handed_over(feed: OdometerFeed, given: list[Portion]) -> list[tuple[list[float], int]]:
    """Speeds handed over, and how many samples of the IMU after them."""
    pieces = [piece for portion in given for piece in feed.pieces(portion)]
    whole = np.concatenate([piece.imu.stamp_ns for piece in pieces])
    np.testing.assert_array_equal(whole, np.concatenate([p.samples.stamp_ns for p in given]))
    return [(piece.odometer.speed.tolist(), len(piece.imu)) for piece in pieces]


def test_what_came_in_time_goes_before_its_portion() -> None:
    came = [100, 400, 500, 501, 990, 1000, 1200]
    feed = OdometerFeed(recording(came, came), Part(), 2.0)
    assert handed_over(feed, portions(100, 50)) == [([0.0, 1.0, 2.0], 50), ([3.0, 4.0, 5.0], 50)]
    assert feed.rest().speed.tolist() == [6.0]


def test_what_came_too_late_goes_where_it_came() -> None:
    # The second one comes 300 ms late, the fourth 250 ms, and so much is waited: 260 ms.
    feed = OdometerFeed(
        recording([100, 200, 500, 600, 800], [100, 505, 600, 850, 860]), Part(), 0.26
    )
    assert handed_over(feed, portions(100, 50)) == [
        ([0.0], 50),
        ([], 0),
        ([1.0, 2.0, 3.0, 4.0], 50),
    ]
    feed = OdometerFeed(
        recording([100, 200, 500, 600, 800], [100, 405, 600, 860, 860]), Part(), 0.19
    )
    assert handed_over(feed, portions(100, 100)) == [([0.0], 40), ([1.0, 2.0], 45),
                                                     ([3.0, 4.0], 15)]  # fmt: skip


def test_nothing_goes_more_than_five_seconds_early() -> None:
    came = list(range(700, 16_000, 1000))
    late = [3200 if stamp == 2700 else stamp for stamp in came]
    feed = OdometerFeed(recording(came, late), Part(), 0.3)
    assert handed_over(feed, portions(1500, 1500)) == [
        ([0.0, 1.0], 319),
        ([2.0, 3.0, 4.0], 181),
        ([5.0, 6.0, 7.0, 8.0, 9.0], 500),
        ([10.0, 11.0, 12.0, 13.0, 14.0], 500),
    ]
    assert feed.rest().speed.tolist() == [15.0]


def test_a_part_of_the_bag_is_the_same_part_of_both() -> None:
    stamps = list(range(0, 3000, 100))
    part = Part(1.0, 0.5)
    imu = make_samples(300)
    rows = np.zeros(len(imu), IMU_ROW)
    rows["stamp_ns"] = rows["log_time"] = imu.stamp_ns
    (inside,) = part.select(iter([rows]))
    portion = Portion(imu.select(part.holds(imu.stamp_ns)), inside["log_time"])
    feed = OdometerFeed(recording(stamps, stamps), part, 2.0)
    ((odometer, samples),) = feed.pieces(portion)
    # From the first sample of the IMU, at 10 ms: 1010 ms up to 1510 ms.
    assert (odometer.stamp_ns - T0).tolist() == [1100 * MS, 1200 * MS, 1300 * MS, 1400 * MS,
                                                 1500 * MS]  # fmt: skip
    assert samples.stamp_ns[0] == T0 + 1010 * MS
    assert len(samples) == 50
    assert len(feed.rest()) == 0


def test_without_an_imu_sample_nothing_is_inside_a_part() -> None:
    assert Part().holds(np.array([1, 2])).all()
    assert not Part(1.0).holds(np.array([1, SECOND * 3])).any()
