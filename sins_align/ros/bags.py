"""Bags: open, find the topics, read the samples of an IMU in the order of recording.

    with open_bag([path]) as bag:
        imu = bag.find_topic("imu")
        for samples in bag.read_imu(imu.name):
            ...
        print(bag.report, bag.warnings)

A bag is a rosbag2 folder, a bare MCAP or sqlite3 file, or a ROS 1 bag, compressed or not.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from sins_align.ros.bags_merge import (
    BagError,
    Source,
    Topic,
    Unit,
    Warnings,
    ZstdMessages,
    merge,
)
from sins_align.ros.bags_open import open_path
from sins_align.ros.bags_portions import Part, Portion, ReadReport, hand_out
from sins_align.ros.bags_topics import choose_topic, describe_topics, types_of
from sins_align.ros.bags_types import typestore_for
from sins_align.ros.cdr import Decoder, ImuDecoder, RawDecoder, Rows
from sins_align.ros.fix import position_from_fix
from sins_align.ros.odometer import OdometerRecording, odometer_row, odometer_samples
from sins_align.types import ImuSamples, Position

__all__ = ["Bag", "BagError", "Part", "Portion", "ReadReport", "Topic", "open_bag"]

_PORTION = 50_000  # samples handed out at a time


class Bag:
    """Several recordings read as one; made by `open_bag`, closed by leaving its context.

    topics : those of all recordings, by name
    warnings : what was wrong and did not prevent reading; it grows while the bag is read
    report : on the last `read_imu`
    """

    def __init__(self, paths: Sequence[Path]) -> None:
        self.warnings = Warnings()
        self.report = ReadReport()
        self.topics: dict[str, Topic] = {}
        self._where = ", ".join(map(str, paths))
        self._stack = ExitStack()
        self._sources: list[tuple[Source, bool]] = []  # and whether its messages are compressed
        with ExitStack() as stack:  # closes what was opened when a later path fails
            for path in paths:
                for source, compressed in open_path(path, self.warnings, stack):
                    self._sources.append((source, compressed))
                    for topic in source.topics:
                        self._add_topic(source.path, topic)
            self._stack = stack.pop_all()

    def __enter__(self) -> Bag:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._stack.close()

    def _add_topic(self, path: Path, topic: Topic) -> None:
        known = self.topics.setdefault(topic.name, topic)
        if (known.type, known.ros1) != (topic.type, topic.ros1):
            raise BagError(
                path, f"{topic.name} is {topic.type}, in another file of this bag {known.type}"
            )

    def find_topic(self, kind: str, requested: str | None = None) -> Topic:
        """The topic of a kind: the requested one, else the only one.

        Parameters
        ----------
        kind : a key of `bags_topics.KINDS` ("imu", "fix", "odom"), or a message type
        requested : name of the topic, with or without the leading slash

        Raises
        ------
        BagError : none or several, or the requested one is missing or of another type; the
            line names the topics that are there
        """
        try:
            return choose_topic(self.topics.values(), kind, requested)
        except LookupError as error:
            raise BagError(self._where, error.args[0]) from None

    def find_optional_topic(self, kind: str, requested: str | None = None) -> Topic | None:
        """As `find_topic`, but None where nothing was requested and there is none or, with a
        warning, several.
        """
        try:
            return self.find_topic(kind, requested)
        except BagError as error:
            if requested:
                raise
            if any(topic.type in types_of(kind) for topic in self.topics.values()):
                self.warnings.append(str(error))
            return None

    def read_imu(
        self,
        topic: str,
        *,
        start_s: float = 0.0,
        duration_s: float | None = None,
        progress: Callable[[float], None] | None = None,
    ) -> Iterator[ImuSamples]:
        """Samples in the order of recording, some 50,000 at a time; `report` tells what came.

        Parameters
        ----------
        topic : name of a topic of sensor_msgs/Imu
        start_s, duration_s : the part to read [s], by header stamp, from the first one on;
            None: to the end
        progress : called now and then with the part of the recording that was read, 0 to 1

        Raises
        ------
        BagError : no message at all, or none in that part
        """
        for portion in self.read_portions(topic, Part(start_s, duration_s), progress):
            yield portion.samples

    def read_portions(
        self, topic: str, part: Part, progress: Callable[[float], None] | None = None
    ) -> Iterator[Portion]:
        """As `read_imu`, with the log times."""
        decoder = ImuDecoder(ros1=self._topic(topic).ros1)
        report = self.report = ReadReport(topic, frame_ids=decoder.frame_ids)
        waiting: list[Rows] = []
        begin = time.perf_counter()
        for rows in part.select(self._rows(topic, decoder, progress)):
            waiting.append(rows)
            if sum(map(len, waiting)) >= _PORTION:
                portion = hand_out(np.concatenate(waiting), report)
                report.read_s += time.perf_counter() - begin
                yield portion
                begin = time.perf_counter()
                waiting = []
        report.lost = decoder.lost
        report.read_s += time.perf_counter() - begin
        if waiting:
            yield hand_out(np.concatenate(waiting), report)
        if decoder.frames_warning:
            self.warnings.note(topic, decoder.frames_warning)
        if decoder.undecodable:
            self.warnings.note(topic, f"{decoder.undecodable} messages are not sensor_msgs/Imu")
        if not report.messages:
            part_of_it = "" if part.is_whole else " in the part asked for"
            damaged = f", {decoder.lost} are damaged" if decoder.lost else ""
            raise BagError(self._where, f"no messages on {topic}{part_of_it}{damaged}")

    def read_odometer(self, topic: str) -> OdometerRecording:
        """All samples of a topic of one of the types of kind "odom".

        Raises BagError.
        """
        begin = time.perf_counter()
        rows, log_times = [], []
        for log_time, message in self.read_messages(topic):
            try:
                rows.append(odometer_row(message))
            except AttributeError as error:  # the bag's definition of the type is another one
                raise BagError(self._where, f"{topic}: {error}") from error
            log_times.append(log_time)
        return OdometerRecording(
            odometer_samples(rows),
            np.array(log_times, dtype=np.int64),
            time.perf_counter() - begin,
        )

    def read_messages(self, topic: str) -> Iterator[tuple[int, Any]]:
        """Log time [ns] and message, deserialised, for topics of any type.

        Raises BagError where the type is unknown; a damaged message is left out, with a
        warning.
        """
        from rosbags.serde import SerdeError

        of = self._topic(topic)
        store = typestore_for(of)
        deserialize = store.deserialize_ros1 if of.ros1 else store.deserialize_cdr
        if of.type not in store.fielddefs:
            raise BagError(self._where, f"{topic}: the bag does not define {of.type}")
        for rows in self._rows(topic, RawDecoder(), None):
            for log_time, payload in rows.tolist():
                try:
                    message = deserialize(payload, of.type)
                except SerdeError as error:
                    self.warnings.note(topic, f"a message was left out, {error}")
                    continue
                yield log_time, message

    def read_fix(self, topic: str) -> Position | None:
        """Position of the first sensor_msgs/NavSatFix that has one, None if none has.

        Raises BagError.
        """
        for _, fix in self.read_messages(topic):
            try:
                position = position_from_fix(fix)
            except AttributeError as error:  # the bag's definition of the type is another one
                raise BagError(self._where, f"{topic}: {error}") from error
            if position is not None:
                return position
        return None

    def _topic(self, name: str) -> Topic:
        if name not in self.topics:
            raise BagError(self._where, f"no topic {name}; {describe_topics(self.topics.values())}")
        return self.topics[name]

    def _rows(
        self, topic: str, decoder: Decoder, progress: Callable[[float], None] | None
    ) -> Iterator[Rows]:
        """Rows of all sources in the order of log time."""
        units: list[Unit] = []
        for source, compressed in self._sources:
            units += source.units(topic, ZstdMessages(decoder) if compressed else decoder)
        begin = min((source.start for source, _ in self._sources if source.start), default=0)
        end = max((source.end for source, _ in self._sources), default=0)
        for rows in merge(units):
            if progress and end > begin:
                done = (int(rows["log_time"][-1]) - begin) / (end - begin)
                progress(min(max(done, 0.0), 1.0))
            yield rows


def open_bag(paths: Sequence[Path]) -> Bag:
    """Open recordings, to be read as one in the order of time.

    Raises BagError, whose one line says what is wrong with which path.
    """
    if not paths:
        raise BagError("bag", "no path given")
    return Bag([Path(path) for path in paths])
