"""MCAP files, read a chunk at a time, whole or cut off, indexed or not.

The records on the top level are walked once, without reading what is in the chunks; the
summary at the end is not needed. Messages are found by the message index that follows each
chunk, which stays right where a chunk's own content is damaged, or by walking the chunk.
Messages that are in no chunk are taken as uncompressed chunks, a stretch at a time.

https://mcap.dev/spec
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from sins_align.ros.bags_mcap_chunk import (
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

_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _MESSAGE_INDEX = 0x02, 0x03, 0x04, 0x05, 0x06, 0x07
_DATA_END = 0x0F
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
        stretch: tuple[int, int, int] | None = None  # position, first and last log time
        complete = False
        while True:
            head = self._read(position, RECORD_HEAD.size)
            opcode, length = RECORD_HEAD.unpack(head) if len(head) == RECORD_HEAD.size else (0, 0)
            body = position + RECORD_HEAD.size
            end = body + length
            fits = opcode != 0 and end <= self._size
            if stretch is not None and (
                opcode in (_CHUNK, _DATA_END, _FOOTER)
                or not fits
                or position - stretch[0] > _STRETCH_SIZE
            ):
                self._add_stretch(*stretch, position)
                stretch = None
            if not fits or opcode == _FOOTER:
                break
            complete = complete or opcode == _DATA_END
            if opcode == _MESSAGE:
                (time,) = struct.unpack("<Q", self._read(body + _LOG_TIME, 8).ljust(8, b"\0"))
                begin, first, last = stretch or (position, time, time)
                stretch = begin, min(first, time), max(last, time)
            else:
                self._take_record(opcode, body, length)
            position = end
        if opcode == _CHUNK:  # the file ends in it
            self._add_chunk(body, self._size - body, cut=True)
        elif not fits and not complete and self._chunks:
            self._chunks[-1].entries.clear()  # those of some channels may be cut off
        if not fits:
            lost = "nothing" if complete else "what followed"
            self._warnings.note(self.path, f"ends without a footer at byte {position}; {lost} lost")

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
        except (struct.error, UnicodeDecodeError):
            if not cut:  # of a cut one the end of the file tells
                self._warnings.note(self.path, f"the chunk at byte {body} is lost: its head")
            return
        position = body + fixed + name_length + 8
        available = body + length - position
        if size > available and not cut:
            self._warnings.note(self.path, f"the chunk at byte {body} is lost: its size")
            return
        self._chunks.append(
            Chunk(position, min(size, available), start, end, compression, uncompressed_size,
                   0 if cut else crc, cut, {})
        )  # fmt: skip

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
            offset = self._indexed(chunk, ids)
        else:
            offset, whole = find_messages(content)
            if not whole and not chunk.cut:
                self._warnings.note(self.path, f"{where} is damaged; what follows in it is lost")
        offset, head = message_heads(buffer, offset, ids)
        if len(offset) < expected:
            missing = expected - len(offset)
            decoder.lost += missing
            self._warnings.note(self.path, f"{where} is damaged: {missing} messages lost")
        size = head["length"].astype(np.int64) - (MESSAGE_HEAD.itemsize - RECORD_HEAD.size)
        log_time = head["times"][:, 0].astype(np.int64)
        yield sort_rows(decoder(buffer, offset + MESSAGE_HEAD.itemsize, size, log_time))

    def _indexed(self, chunk: Chunk, ids: set[int]) -> IntArray:
        """Where the message index says that the messages begin in the content."""
        entries = [
            np.frombuffer(self._read(position, 16 * count), "<u8")[1::2]
            for key, (position, count) in chunk.entries.items()
            if key in ids
        ]
        offset = np.concatenate(entries)
        return np.sort(offset[offset < chunk.uncompressed_size].astype(np.int64))


def open_mcap(path: Path, warnings: Warnings) -> McapFile:
    """Open an MCAP file. Raises BagError when there is no message in it."""
    file = McapFile(path, warnings)
    if not file.topics:
        file.close()
        raise BagError(path, "no ROS messages in this MCAP file")
    return file
