"""Columns of whole numbers as few bytes: what is small or alike goes together, a compressor does the rest."""

from __future__ import annotations

import struct
import zlib

import numpy as np
import zstandard
from numpy.typing import NDArray

from splitslam.errors import DataError

_HEAD = struct.Struct("<BII")  # version, CRC-32 of what follows, length of the columns
_VERSION = 1
_MOST_BYTES = 1 << 22

Ints = NDArray[np.int64]


class ColumnWriter:
    """Columns one after the other; `packed` ends it."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []

    def add(self, values: NDArray[np.integer] | NDArray[np.bool_]) -> None:
        """(n,): signs last, so that small numbers have zeros above; as many planes of bytes as the largest needs."""
        signed = np.ascontiguousarray(values, np.int64)
        folded = ((signed << 1) ^ (signed >> 63)).view(np.uint64)
        width = (int(folded.max(initial=0)).bit_length() + 7) // 8
        planes = folded.astype("<u8").view(np.uint8).reshape(-1, 8)[:, :width]
        self._parts.append(bytes([width]) + planes.T.tobytes())

    def text(self, text: str) -> None:
        """A few words."""
        data = text.encode()
        self.add(np.array([len(data)]))
        self._parts.append(data)

    def packed(self, level: int) -> bytes:
        """All of it, compressed as hard as that, with a checksum."""
        body = b"".join(self._parts)
        packed = zstandard.ZstdCompressor(level=level, write_content_size=False).compress(body)
        return _HEAD.pack(_VERSION, zlib.crc32(packed), len(body)) + packed


class ColumnReader:
    """What `ColumnWriter` wrote, in the same order. Every method raises DataError("corrupt")."""

    def __init__(self, data: bytes) -> None:
        if len(data) < _HEAD.size:
            raise DataError("corrupt", "columns shorter than their header")
        version, checksum, size = _HEAD.unpack_from(data)
        if version != _VERSION or size > _MOST_BYTES:
            raise DataError("corrupt", f"columns of version {version}, expected {_VERSION}")
        if zlib.crc32(data[_HEAD.size :]) != checksum:
            raise DataError("corrupt", "columns are not what was written")
        try:
            self._body = zstandard.ZstdDecompressor().decompress(data[_HEAD.size :], max_output_size=size)
        except zstandard.ZstdError as error:
            raise DataError("corrupt", f"columns: {error}") from None
        if len(self._body) != size:
            raise DataError("corrupt", f"columns of {len(self._body)} bytes, expected {size}")
        self._at = 0

    def take(self, count: int) -> Ints:
        """The next column, of `count` numbers."""
        (width,) = self._bytes(1)
        if width > 8:
            raise DataError("corrupt", f"numbers of {width} bytes")
        planes = np.frombuffer(self._bytes(width * count), np.uint8).reshape(width, count)
        folded = np.zeros((count, 8), np.uint8)
        folded[:, :width] = planes.T
        values = folded.view("<u8")[:, 0]
        return (values >> 1).astype(np.int64) ^ -(values & 1).astype(np.int64)

    def text(self) -> str:
        (size,) = self.take(1)
        return self._bytes(int(size)).decode(errors="replace")

    def _bytes(self, count: int) -> bytes:
        if not 0 <= count <= len(self._body) - self._at:
            raise DataError("corrupt", "columns end too early")
        self._at += count
        return self._body[self._at - count : self._at]
