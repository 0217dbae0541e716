"""MCAP files, read a chunk at a time, whole or cut off, indexed or not.

The records on the top level are walked once, without reading what is in the chunks; the
summary at the end is not needed. Messages are found by the message index that follows each
chunk, which stays right where a chunk's own content is damaged, or by walking the chunk.
Messages that are in no chunk are taken as uncompressed chunks, a stretch at a time.

https://mcap.dev/spec
"""

from __future__ import annotations

import struct
from bisect import bisect_right
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from sins_align.ros.bags_mcap_chunk import (
    MESSAGE,
    MESSAGE_HEAD,
    RECORD_HEAD,
    Chunk,
    DamagedError,
    chunk_content,
    find_messages,
    message_heads,
    read_string,
    walk,
)
from sins_align.ros.bags_merge import BagError, Topic, Unit, Warnings, sort_rows
from sins_align.ros.cdr import Decoder, Rows
from sins_align.types import IntArray

MAGIC = b"\x89MCAP0\r\n"

_FOOTER, _SCHEMA, _CHANNEL, _CHUNK, _MESSAGE_INDEX = 0x02, 0x03, 0x04, 0x06, 0x07
_CHUNK_INDEX, _DATA_END = 0x08, 0x0F
_FOOTER_HEAD = RECORD_HEAD.pack(_FOOTER, 20)
_FOOTER_SIZE = len(_FOOTER_HEAD) + 20 + len(MAGIC)
_CHUNK_START = 16  # where it stands in a chunk index record
_CHUNK_HEAD = struct.Struct("<QQQII")  # start, end, size, crc, length of the compression's name
_LOG_TIME = 6  # where it stands in a message record
_STRETCH_SIZE = 1 << 20  # of messages outside of chunks [bytes]


class _Channel(NamedTuple):
    schema: int
    topic: str
    encoding: str


class McapFile:
    """One MCAP file; see `bags_merge.Source`."""

    def __init__(self, path: Path, warnings: Warnings) -> None:
        self.path = path
        self._warnings = warnings
        self._file = path.open("rb")
        self._size = path.stat().st_size
        self._schemas: dict[int, tuple[str, str]] = {}
        self._channels: dict[int, _Channel] = {}
        self._chunks: list[Chunk] = []
        self.ending = "which is complete"
        self._walk_file()
        for chunk in self._chunks:
            if not chunk.entries or chunk.entries.keys() - self._channels.keys():
                self._read_definitions(chunk)
        self.topics = self._list_topics()
        self.start = min((chunk.start for chunk in self._chunks), default=0)
        self.end = max((chunk.end for chunk in self._chunks), default=0)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def units(self, topic: str, decoder: Decoder) -> list[Unit]:
        """One unit a chunk."""
        ids = {key for key, channel in self._channels.items() if channel.topic == topic}
        return [
            Unit(chunk.start, partial(self._rows, chunk, ids, decoder))
            for chunk in self._chunks
            if ids and (not chunk.entries or ids & chunk.entries.keys())
        ]

    def _read(self, position: int, size: int) -> bytes:
        self._file.seek(position)
        return self._file.read(size)

    def _walk_file(self) -> None:
        """Note where the chunks are, and what channels there are."""
        position = len(MAGIC)
        starts = self._read_chunk_starts()
        stretch: tuple[int, int, int] | None = None  # position, first and last log time
        complete = False
        while True:
            opcode, body, end = self._read_head(position)
            resume = next((start for start in starts[bisect_right(starts, position) :]), 0)
            fits = opcode != 0 and end <= (resume or self._size)
            if stretch is not None and (
                opcode in (_CHUNK, _DATA_END, _FOOTER)
                or not fits
                or position - stretch[0] > _STRETCH_SIZE
            ):
                self._add_stretch(*stretch, position)
                stretch = None
            if not fits and not complete and self._chunks:
                self._chunks[-1].entries.clear()  # those of some channels may be missing
            if not fits and resume:
                self._warnings.note(self.path, f"damaged from byte {position} to {resume}")
                position = resume
                continue
            if not fits or opcode == _FOOTER:
                break
            complete = complete or opcode == _DATA_END
            if opcode == MESSAGE:
                (time,) = struct.unpack("<Q", self._read(body + _LOG_TIME, 8).ljust(8, b"\0"))
                begin, first, last = stretch or (position, time, time)
                stretch = begin, min(first, time), max(last, time)
            else:
                self._take_record(opcode, body, end - body)
            position = end
        if not fits:
            self._note_ending(opcode, position, complete)

    def _note_ending(self, opcode: int, position: int, complete: bool) -> None:
        """The file ends in the record at `position`; `complete`: behind all the messages."""
        if opcode == _CHUNK:
            body = position + RECORD_HEAD.size
            self._add_chunk(body, self._size - body, cut=True)
        lost = "nothing" if complete else "what followed"
        self.ending = f"which ends without a footer at byte {position}; {lost} is lost"
        self._warnings.note(self.path, f"an MCAP file {self.ending}")

    def _read_head(self, position: int) -> tuple[int, int, int]:
        """Opcode of a record, where its content begins and ends; opcode 0: there is none."""
        data = self._read(position, RECORD_HEAD.size)
        opcode, length = RECORD_HEAD.unpack(data) if len(data) == RECORD_HEAD.size else (0, 0)
        body = position + RECORD_HEAD.size
        return opcode, body, body + length

    def _read_chunk_starts(self) -> list[int]:
        """Where the summary, if there is one, says that chunks begin: to resume at."""
        footer = self._read(max(self._size - _FOOTER_SIZE, 0), _FOOTER_SIZE)
        if not (footer.startswith(_FOOTER_HEAD) and footer.endswith(MAGIC)):
            return []
        (position,) = struct.unpack_from("<Q", footer, len(_FOOTER_HEAD))
        starts: list[int] = []
        while 0 < position < self._size - _FOOTER_SIZE:
            opcode, body, end = self._read_head(position)
            if opcode == _CHUNK_INDEX and end - body >= _CHUNK_START + 8:
                starts += struct.unpack("<Q", self._read(body + _CHUNK_START, 8))
            position = end
        return sorted(start for start in starts if start < self._size)

    def _take_record(self, opcode: int, body: int, length: int) -> None:
        if opcode == _CHUNK:
            self._add_chunk(body, length)
        elif opcode in (_SCHEMA, _CHANNEL):
            self._define(opcode, self._read(body, length))
        elif opcode == _MESSAGE_INDEX and self._chunks and length >= 6:
            channel, size = struct.unpack("<HI", self._read(body, 6))
            if size == length - 6 and size:
                self._chunks[-1].entries[channel] = body + 6, size // 16

    def _add_stretch(self, position: int, first: int, last: int, end: int) -> None:
        size = end - position
        self._chunks.append(Chunk(position, size, first, last, "", size, 0, False, {}))

    def _add_chunk(self, body: int, length: int, cut: bool = False) -> None:
        fixed = _CHUNK_HEAD.size
        data = self._read(body, min(length, fixed + 64))
        try:
            start, end, uncompressed_size, crc, name_length = _CHUNK_HEAD.unpack_from(data)
            compression = data[fixed : fixed + name_length].decode()
            (size,) = struct.unpack_from("<Q", data, fixed + name_length)
            position = body + fixed + name_length + 8
            if position + size > body + length and not cut:
                raise struct.error("the content goes beyond the chunk")
        except (struct.error, UnicodeDecodeError):
            if not cut:  # keeps the message index that follows, for it tells what is lost
                last = self._chunks[-1].end if self._chunks else 0
                self._chunks.append(Chunk(body, 0, last, last, "", -1, 0, False, {}))
            return
        size = min(size, body + length - position)
        crc = 0 if cut else crc
        self._chunks.append(
            Chunk(position, size, start, end, compression, uncompressed_size, crc, cut, {})
        )

    def _define(self, opcode: int, data: bytes | memoryview) -> None:
        """Take in the content of a Schema or Channel record."""
        try:
            if opcode == _SCHEMA:
                (key,) = struct.unpack_from("<H", data)
                name, position = read_string(data, 2)
                encoding, position = read_string(data, position)
                text, _ = read_string(data, position)
                self._schemas[key] = name, text if encoding in ("ros2msg", "ros1msg") else ""
            else:
                key, schema = struct.unpack_from("<HH", data)
                topic, position = read_string(data, 4)
                encoding, _ = read_string(data, position)
                self._channels[key] = _Channel(schema, topic, encoding)
        except (struct.error, UnicodeDecodeError):
            self._warnings.note(self.path, "a damaged definition was ignored")

    def _read_definitions(self, chunk: Chunk) -> None:
        """Channels that are defined within `chunk`, for a file without a summary."""
        try:
            data = chunk_content(chunk, self._read(chunk.position, chunk.size))
        except DamagedError:
            return  # noted when its messages are read
        for position, opcode, end in walk(data):
            if opcode in (_SCHEMA, _CHANNEL):
                self._define(opcode, data[position + RECORD_HEAD.size : end])

    def _list_topics(self) -> list[Topic]:
        topics: dict[str, Topic] = {}
        for channel in self._channels.values():
            name, text = self._schemas.get(channel.schema, ("", ""))
            package, _, base = name.rpartition("/")
            kind = name if package.endswith("/msg") else f"{package}/msg/{base}"
            ros1 = channel.encoding == "ros1"
            if ros1 or channel.encoding == "cdr":
                topics[channel.topic] = Topic(channel.topic, kind, ros1, text)
        return list(topics.values())

    def _rows(self, chunk: Chunk, ids: set[int], decoder: Decoder) -> Iterator[Rows]:
        """The messages of some channels in one chunk, sorted by log time."""
        where = f"the chunk at byte {chunk.position}"
        expected = sum(count for key, (_, count) in chunk.entries.items() if key in ids)
        try:
            content = chunk_content(chunk, self._read(chunk.position, chunk.size))
        except DamagedError as error:
            decoder.lost += expected
            self._warnings.note(self.path, f"{where} is lost, {error}: {expected} messages")
            return
        buffer = np.frombuffer(content, np.uint8)
        if chunk.entries:
            offset, log_time = self._indexed(chunk, ids)
            offset, head = message_heads(buffer, offset, ids, log_time)
        else:
            offset, whole = find_messages(content)
            offset, head = message_heads(buffer, offset, ids)
            if not whole and not chunk.cut:
                self._warnings.note(self.path, f"{where} is damaged; what follows in it is lost")
        if len(offset) < expected:
            missing = expected - len(offset)
            decoder.lost += missing
            self._warnings.note(self.path, f"{where} is damaged: {missing} messages lost")
        size = head["length"].astype(np.int64) - (MESSAGE_HEAD.itemsize - RECORD_HEAD.size)
        log_time = head["log_time"].astype(np.int64)
        yield sort_rows(decoder(buffer, offset + MESSAGE_HEAD.itemsize, size, log_time))

    def _indexed(self, chunk: Chunk, ids: set[int]) -> tuple[IntArray, IntArray]:
        """Where in the content the messages begin, and their log time, says the index."""
        entries = [
            np.frombuffer(self._read(position, 16 * count), "<i8").reshape(-1, 2)
            for key, (position, count) in chunk.entries.items()
            if key in ids
        ]
        times_offsets = np.concatenate(entries)
        if len(entries) > 1:
            times_offsets = times_offsets[np.argsort(times_offsets[:, 1])]
        return times_offsets[:, 1], times_offsets[:, 0]


def open_mcap(path: Path, warnings: Warnings) -> McapFile:
    """Open an MCAP file. Raises BagError when there is no message in it."""
    file = McapFile(path, warnings)
    if not file.topics:
        file.close()
        raise BagError(path, f"no ROS topics in this MCAP file, {file.ending}")
    return file
