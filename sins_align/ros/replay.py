"""The estimation over a bag: the session that the live node has, fed from a file."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from sins_align.config import ConfigError, OdoConfig, SwingConfig
from sins_align.ros.bags import Bag, Part
from sins_align.ros.publish_grid import PublishGrid, find_sample
from sins_align.ros.replay_feed import OdometerFeed
from sins_align.ros.truth import Truth
from sins_align.session import Session
from sins_align.types import Array, Estimate, ImuSamples, OdometerSamples, Update


@dataclass(frozen=True)
class AttitudeRecord:
    """An estimate at the time of an output, with the sample (3,) [rad/s], [m/s^2] there."""

    estimate: Estimate
    w_ib_b: Array
    f_ib_b: Array


@dataclass
class Replay:
    """A session and what came of it, block by block.

    records : at the grid of outputs, if they were asked for
    estimate_s : wall time of the estimation [s]
    """

    session: Session
    updates: list[Update] = field(default_factory=list)
    records: list[AttitudeRecord] = field(default_factory=list)
    estimate_s: float = 0.0

    def add(self, samples: ImuSamples, grid: PublishGrid | None = None) -> None:
        """Take in samples; with a grid, keep a record where the live node would publish."""
        if grid is not None:
            samples = self._add_recorded(samples, grid)
        begin = time.perf_counter()
        self.updates += self.session.add_imu(samples)
        self.estimate_s += time.perf_counter() - begin

    def add_odometer(self, samples: OdometerSamples) -> None:
        """Take in samples of the odometer."""
        if len(samples):
            begin = time.perf_counter()
            self.updates += self.session.add_odometer(samples)
            self.estimate_s += time.perf_counter() - begin

    def _add_recorded(self, samples: ImuSamples, grid: PublishGrid) -> ImuSamples:
        """Take in samples up to the last output; the rest."""
        begin = 0
        for k, stamp in enumerate(samples.stamp_ns.tolist()):
            if grid.reached(stamp):
                part = samples.select(slice(begin, k + 1))
                self.add(part)
                self._record(part, stamp)
                begin = k + 1
        return samples.select(slice(begin, None))

    def _record(self, samples: ImuSamples, stamp_ns: int) -> None:
        estimate = self.session.estimate
        sample = find_sample(samples, stamp_ns, estimate)
        if estimate is not None and sample is not None:
            self.records.append(AttitudeRecord(estimate, *sample))


class Outcome(NamedTuple):
    """A replay that is done.

    title : what was replayed
    estimate : the session's conclusion
    document : the content of result.json
    truth : to compare with, None where it is not known
    frame_id : of the IMU
    """

    title: str
    replay: Replay
    estimate: Estimate | None
    document: dict[str, Any]
    truth: Truth | None
    frame_id: str


def open_session(config: SwingConfig | OdoConfig, bag: Bag, fix_topic: str | None) -> Session:
    """A session at the configured position, else at that of the bag's first valid fix.

    Raises
    ------
    ConfigError : neither is there
    BagError : the topic asked for is not there
    """
    session = Session(config)
    if session.position is not None:
        return session
    topic = bag.find_optional_topic("fix", fix_topic)
    position = None if topic is None else bag.read_fix(topic.name)
    if position is None:
        found = "no topic with a fix" if topic is None else f"no valid fix on {topic.name}"
        raise ConfigError(f"latitude_deg: not given, and the bag has {found}: add --latitude-deg")
    session.set_position(position)
    return session


def run_replay(
    bag: Bag,
    session: Session,
    imu_topic: str | None,
    odom_topic: str | None = None,
    *,
    part: Part | None = None,
    progress: Callable[[float], None] | None = None,
    record_rate_hz: float | None = None,
) -> Replay:
    """Feed a bag to a session.

    Parameters
    ----------
    imu_topic, odom_topic : None: the only one
    part : of the bag, None: all of it
    progress : told the part that is done, 0 to 1
    record_rate_hz : rate of the records, None: without

    Raises
    ------
    BagError : no such topic, or no samples
    """
    topic = bag.find_topic("imu", imu_topic)
    part = part or Part()
    replay = Replay(session)
    grid = None if record_rate_hz is None else PublishGrid(record_rate_hz)
    feed, read_s = _open_feed(bag, session.config, odom_topic, part)
    for portion in bag.read_portions(topic.name, part, progress):
        if feed is None:
            replay.add(portion.samples, grid)
            continue
        for odometer, samples in feed.pieces(portion):
            replay.add_odometer(odometer)
            replay.add(samples, grid)
    if feed is not None:
        replay.add_odometer(feed.rest())
    bag.report.read_s += read_s
    return replay


def _open_feed(
    bag: Bag, config: SwingConfig | OdoConfig, odom_topic: str | None, part: Part
) -> tuple[OdometerFeed | None, float]:
    """The odometer, None where none is needed, and the time spent on reading it [s].

    Raises
    ------
    BagError : it is needed, or was asked for, and is not there
    """
    if not isinstance(config, OdoConfig) or (config.stationary and not odom_topic):
        return None, 0.0
    recording = bag.read_odometer(bag.find_topic("odom", odom_topic).name)
    return OdometerFeed(recording, part, config.odometer.timeout_s), recording.read_s
