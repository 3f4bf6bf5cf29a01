"""How a frame lies in a spool file: a header with a checksum, then the frame as it goes on the wire.

Damage costs the record that it hit: reading goes on at the next header whose checksum fits.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass

MAGIC = b"SSf1"
_KEPT, _DROPPED = 1, 0
_HEADER = struct.Struct("<4sBB2xIQqQI")  # magic, kept, dense, size of the body, seq, stamp, durable_seq, checksum
_SUMMED = slice(5, _HEADER.size - 4)  # `kept` is outside: it is written over in place when a frame is given up
KEPT_AT = 4
DROPPED_MARK = bytes([_DROPPED])


@dataclass(frozen=True, slots=True)
class Head:
    """What is known of a stored frame without parsing it. durable_seq: the service's, when the frame was written."""

    seq: int
    stamp_ns: int
    dense: bool
    durable_seq: int
    body_bytes: int

    @property
    def record_bytes(self) -> int:
        return _HEADER.size + self.body_bytes


@dataclass(frozen=True, slots=True)
class Found:
    """A whole record in a file. kept: False for a frame that was given up."""

    head: Head
    offset: int
    kept: bool


@dataclass(frozen=True, slots=True)
class Damage:
    """A stretch of a file that is no record. torn: nothing follows it, as a writer that was cut off leaves it."""

    offset: int
    torn: bool


def pack(head: Head, body: bytes) -> bytes:
    """The record's bytes; `head.body_bytes` is taken from the body."""
    fields = (MAGIC, _KEPT, head.dense, len(body), head.seq, head.stamp_ns, head.durable_seq)
    bare = _HEADER.pack(*fields, 0)
    return _HEADER.pack(*fields, zlib.crc32(body, zlib.crc32(bare[_SUMMED]))) + body


def unpack(data: bytes, offset: int = 0) -> tuple[Found, bytes] | None:
    """The record at `offset` and its body, None when there is no whole one."""
    if data[offset : offset + 4] != MAGIC or offset + _HEADER.size > len(data):
        return None
    _, kept, dense, size, seq, stamp_ns, durable_seq, checksum = _HEADER.unpack_from(data, offset)
    start = offset + _HEADER.size
    body = data[start : start + size]
    header = data[offset:start]
    if len(body) < size or zlib.crc32(body, zlib.crc32(header[_SUMMED])) != checksum:
        return None
    return Found(Head(seq, stamp_ns, bool(dense), durable_seq, size), offset, kept != _DROPPED), body


def walk(data: bytes) -> list[Found | Damage]:
    """Everything in a file, in its order."""
    found: list[Found | Damage] = []
    offset = 0
    while offset < len(data):
        record = unpack(data, offset)
        if record is not None:
            found.append(record[0])
            offset += record[0].head.record_bytes
            continue
        start, offset = offset, _next_record(data, offset + 1)
        found.append(Damage(start, torn=offset == len(data)))
    return found


def _next_record(data: bytes, offset: int) -> int:
    """Where the next whole record begins, or the end."""
    while (offset := data.find(MAGIC, offset)) >= 0:
        if unpack(data, offset) is not None:
            return offset
        offset += 1
    return len(data)
