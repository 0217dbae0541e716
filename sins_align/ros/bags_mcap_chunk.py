"""The content of MCAP chunks: decompress it, find the messages in it."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from sins_align.ros.cdr import Bytes, Rows
from sins_align.types import IntArray

MESSAGE = 0x05  # opcode
RECORD_HEAD = struct.Struct("<BQ")  # opcode, length of what follows
MESSAGE_HEAD = np.dtype(
    [
        ("op", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<i8"),
        ("publish_time", "<i8"),
    ]
)
_MAX_SIZE = 1 << 30  # of a chunk, more than any recorder writes


class DamagedError(Exception):
    """A chunk that cannot be used; the text says why."""


class Chunk(NamedTuple):
    """Where a chunk stands, and what its head states."""

    position: int  # of its content in the file
    size: int  # of its content in the file
    start: int  # log time [ns]
    end: int
    compression: str
    uncompressed_size: int
    crc: int  # of the uncompressed content, 0 when unknown
    cut: bool  # the file ends within it
    entries: dict[int, tuple[int, int]]  # channel: position and count of its index entries


def chunk_content(chunk: Chunk, data: bytes) -> bytes:
    """The records of a chunk, from what stands in the file.

    Raises DamagedError when they are not what was written.
    """
    if not 0 <= chunk.uncompressed_size <= _MAX_SIZE:
        raise DamagedError("its head is damaged")
    content = _decompress(data, chunk)
    if chunk.cut:
        return content
    if len(content) != chunk.uncompressed_size:
        raise DamagedError("its content has the wrong size")
    if chunk.crc and zlib.crc32(content) != chunk.crc:
        raise DamagedError("its checksum is wrong")
    return content


def _decompress(data: bytes, chunk: Chunk) -> bytes:
    """Content of a chunk; of one that is cut off, as much as there is."""
    if chunk.compression == "":
        return data
    content: bytes
    if chunk.compression == "zstd":
        import zstandard

        try:
            content = zstandard.ZstdDecompressor().decompressobj().decompress(data)
        except (zstandard.ZstdError, MemoryError) as error:
            raise DamagedError("it cannot be decompressed") from error
        return content
    if chunk.compression == "lz4":
        import lz4.frame  # type: ignore[import-untyped]

        try:
            content = lz4.frame.LZ4FrameDecompressor().decompress(data)
        except (RuntimeError, MemoryError) as error:
            raise DamagedError("it cannot be decompressed") from error
        return content
    raise DamagedError(f"unknown compression {chunk.compression!r}")


def walk(content: bytes) -> Iterator[tuple[int, int, int]]:
    """Position, opcode and end of each record, as far as they fit."""
    position = 0
    while position + RECORD_HEAD.size <= len(content):
        opcode, length = RECORD_HEAD.unpack_from(content, position)
        end = position + RECORD_HEAD.size + length
        if end > len(content) or opcode == 0:
            return
        yield position, opcode, end
        position = end


def find_messages(content: bytes) -> tuple[IntArray, bool]:
    """Positions of the message records, and whether the walk came to the end."""
    found: list[int] = []
    end = 0
    for position, opcode, next_position in walk(content):
        end = next_position
        if opcode == MESSAGE:
            found.append(position)
    return np.array(found, np.int64), end == len(content)


def message_heads(
    buffer: Bytes, offset: IntArray, ids: set[int], log_time: IntArray | None = None
) -> tuple[IntArray, Rows]:
    """Of the offsets those at which a message of one of the channels stands, and its head.

    log_time : of the message at each offset, where it is known [ns]
    """
    inside = (offset >= 0) & (offset <= len(buffer) - MESSAGE_HEAD.itemsize)
    offset = offset[inside]
    view: Rows = np.ndarray(
        max(len(buffer) - MESSAGE_HEAD.itemsize + 1, 0), MESSAGE_HEAD, buffer, strides=(1,)
    )
    head = view[offset]
    length = head["length"]
    good = (
        (head["op"] == MESSAGE)
        & np.isin(head["channel"], list(ids))
        & (length >= MESSAGE_HEAD.itemsize - RECORD_HEAD.size)
        & (length <= (len(buffer) - RECORD_HEAD.size - offset).astype(np.uint64))
    )
    if log_time is not None:
        good &= head["log_time"] == log_time[inside]
    return (offset, head) if good.all() else (offset[good], head[good])


def read_string(data: bytes | memoryview, position: int) -> tuple[str, int]:
    """A string with its length before it, and where it ends."""
    (length,) = struct.unpack_from("<I", data, position)
    begin = position + 4
    if begin + length > len(data):
        raise struct.error("a string goes beyond its record")
    return str(data[begin : begin + length], "utf-8"), begin + length
