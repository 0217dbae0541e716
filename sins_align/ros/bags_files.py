"""Files of the kinds other than MCAP: sqlite3 (rosbag2) and ROS 1 bags."""

from __future__ import annotations

import sqlite3
import struct
from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sins_align.ros.bags_merge import BagError, Topic, Unit, Warnings, sort_rows
from sins_align.ros.cdr import Decoder, Rows, pack_payloads

if TYPE_CHECKING:
    from rosbags.interfaces import Connection

_BATCH = 20_000  # messages
_SQLITE_ERRORS = (sqlite3.DatabaseError, UnicodeDecodeError)  # the latter of damaged names
# sqlite3 does not keep to the types of its columns where the file is damaged.
_TOPICS = "SELECT id, name, type FROM topics WHERE typeof(name) = 'text' AND typeof(type) = 'text'"
_MESSAGES = (
    "SELECT timestamp, data FROM messages"
    " WHERE typeof(data) = 'blob' AND typeof(timestamp) = 'integer'"
)
_PAGE_SIZE, _PAGE_COUNT = slice(16, 18), slice(28, 32)  # in the head of an sqlite3 file


class SqliteFile:
    """One sqlite3 storage file of rosbag2; see `bags_merge.Source`."""

    def __init__(self, path: Path, warnings: Warnings) -> None:
        self.path = path
        self._warnings = warnings
        self._cut_page = _page_size_if_cut(path)
        # Of a cut file the first rows are there, the index on the time is not.
        self._order = "id" if self._cut_page else "timestamp"
        if self._cut_page:
            warnings.note(path, "the file is cut off; what followed is lost")
        # A read-only medium has no room for the files that locking needs.
        uri = f"{path.absolute().as_uri()}?immutable=1"
        self._database = sqlite3.connect(uri, uri=True, check_same_thread=False)
        try:
            if self._cut_page:  # else sqlite3 refuses a file with too few pages
                self._database.execute("PRAGMA writable_schema = ON")
            self._ids, self.topics = self._list_topics()
            self.start = self.end = self._first("ASC")
            # A cut file lacks its end.
            with suppress(*_SQLITE_ERRORS):
                self.end = self._first("DESC")
        except _SQLITE_ERRORS as error:
            self._database.close()
            raise BagError(path, f"no readable rosbag2 database: {error}") from error

    def close(self) -> None:
        """Close the file."""
        self._database.close()

    def units(self, topic: str, decoder: Decoder) -> list[Unit]:
        """One unit."""
        ids = self._ids.get(topic)
        return [Unit(self.start, partial(self._rows, ids, decoder))] if ids else []

    def _list_topics(self) -> tuple[dict[str, list[int]], list[Topic]]:
        definitions: dict[str, str] = {}
        tables = self._database.execute("SELECT name FROM sqlite_master").fetchall()
        if ("message_definitions",) in tables:  # since Iron
            query = "SELECT topic_type, encoded_message_definition FROM message_definitions"
            definitions = dict(self._database.execute(query + " WHERE encoding = 'ros2msg'"))
        ids: dict[str, list[int]] = {}
        topics: dict[str, Topic] = {}
        for key, name, kind in self._database.execute(_TOPICS):
            ids.setdefault(name, []).append(key)
            topics[name] = Topic(name, kind, False, definitions.get(kind, ""))
        return ids, list(topics.values())

    def _first(self, direction: str) -> int:
        """Log time of the first message in the order, 0 if there is none."""
        query = f"SELECT timestamp FROM messages ORDER BY {self._order} {direction} LIMIT 1"
        row = self._database.execute(query).fetchone()
        return row[0] if row and isinstance(row[0], int) else 0

    def _rows(self, ids: list[int], decoder: Decoder) -> Iterator[Rows]:
        marks = ",".join("?" * len(ids))
        query = f"{_MESSAGES} AND topic_id IN ({marks}) ORDER BY {self._order}"
        try:
            cursor = self._database.execute(query, ids)
            messages = _before_cut(cursor, self._cut_page) if self._cut_page else cursor
            yield from _decode(messages, decoder, *_SQLITE_ERRORS)
        except _SQLITE_ERRORS as error:
            self._warnings.note(self.path, f"{error}; what followed is lost")


class Ros1File:
    """One ROS 1 bag; see `bags_merge.Source`."""

    def __init__(self, path: Path, warnings: Warnings) -> None:
        from rosbags.rosbag1 import Reader, ReaderError

        self.path = path
        self._warnings = warnings
        self._reader = Reader(path)
        # Beside its own errors the reader lets those of parsing and decompression through,
        # and asserts that the index is right.
        self._errors = (
            ReaderError,
            ValueError,
            LookupError,
            struct.error,
            OSError,
            RuntimeError,
            AssertionError,
        )
        try:
            self._reader.open()
        except self._errors as error:
            raise BagError(path, f"no readable ROS 1 bag: {error}") from error
        self.topics = list({
            entry.topic: Topic(entry.topic, entry.msgtype, True, str(entry.msgdef.data))
            for entry in self._reader.connections
        }.values())  # fmt: skip
        self.start = self._reader.start_time if self.topics else 0
        self.end = self._reader.end_time if self.topics else 0

    def close(self) -> None:
        """Close the file."""
        self._reader.close()

    def units(self, topic: str, decoder: Decoder) -> list[Unit]:
        """One unit."""
        chosen = [entry for entry in self._reader.connections if entry.topic == topic]
        return [Unit(self.start, partial(self._rows, chosen, decoder))] if chosen else []

    def _rows(self, connections: list[Connection], decoder: Decoder) -> Iterator[Rows]:
        messages = ((time, data) for _, time, data in self._reader.messages(connections))
        try:
            yield from _decode(messages, decoder, *self._errors)
        except self._errors as error:
            self._warnings.note(self.path, f"{error!r}; what followed is lost")


def _decode(
    messages: Iterator[tuple[int, bytes]], decoder: Decoder, *errors: type[Exception]
) -> Iterator[Rows]:
    """Rows in batches; when one of `errors` comes, those before it, then the error."""
    failure: Exception | None = None
    while failure is None:
        batch: list[tuple[int, bytes]] = []
        try:
            batch.extend(islice(messages, _BATCH))  # keeps what came before an error
        except errors as error:
            failure = error
        if batch:
            times, payloads = zip(*batch, strict=True)
            yield sort_rows(decoder(*pack_payloads(payloads), np.array(times, np.int64)))
        elif failure is None:
            return
    raise failure


def _before_cut(messages: Iterator[tuple[int, bytes]], page: int) -> Iterator[tuple[int, bytes]]:
    """All but those that may stand in the last page, the rest of which reads as zeros."""
    held: deque[tuple[int, bytes]] = deque()
    for message in messages:
        held.append(message)
        if len(held) > page // max(len(message[1]), 1) + 1:
            yield held.popleft()


def _page_size_if_cut(path: Path) -> int:
    """Page size of an sqlite3 file with fewer pages than its head states [bytes], else 0."""
    with path.open("rb") as file:
        head = file.read(100)
    stated = int.from_bytes(head[_PAGE_SIZE], "big")
    page = 65536 if stated == 1 else stated
    return page if path.stat().st_size < page * int.from_bytes(head[_PAGE_COUNT], "big") else 0
