"""Feature codec, version 1, as far as it is still needed: the decoder of frames in stores and of older agents.

Layout (little-endian): header (`_HEADER`), plane lengths, zstd planes of symbols, raw bits, CRC-32 of all before.
Planes: small integers (points of each ring, knots), class and intensity, column, range, azimuth, elevation, time.
"""

from __future__ import annotations

import struct
import threading
import zlib

import numpy as np
import zstandard
from numpy.typing import NDArray

from splitslam.codec import _version1_kernels as kernels
from splitslam.codec import version1_motion as motion_codec
from splitslam.codec.beams import directions_of, table_of
from splitslam.codec.limits import MAX_POINTS, MAX_RINGS, DecodeError
from splitslam.features import FeatureFrame, FeatureSet

VERSION = 1
_SEGMENT_NS = 400_000  # of the motion table that version 1 was made with
_SIGNED = (False, True, True, True, True)  # rows of the residuals
_PLANES = 2 + len(_SIGNED)
_VELOCITY_KNOWN, _UNIFORM_KNOTS = 1, 2
# version, flags, rings, columns, knots, points, step um, ns per column / 256, raw bytes
_HEADER = struct.Struct("<BBHHHIIiI")
_LENGTHS = struct.Struct(f"<{_PLANES}I")
_CRC = struct.Struct("<I")
_FIXED = _HEADER.size + motion_codec.BLOCK.size + _LENGTHS.size


class _Zstd(threading.local):
    """Compression contexts are not shared between threads."""

    def __init__(self) -> None:
        self._decompressor = zstandard.ZstdDecompressor(
            format=zstandard.FORMAT_ZSTD1_MAGICLESS, max_window_size=1 << 23
        )

    def decompress(self, packed: bytes, size: int) -> NDArray[np.uint8]:
        """Exactly `size` bytes out of `packed`, or DecodeError; never allocates for what a header claims."""
        try:
            with self._decompressor.stream_reader(packed) as reader:
                plane = reader.read(size + 1)
        except zstandard.ZstdError as error:
            raise DecodeError("corrupt", f"plane: {error}") from None
        if len(plane) != size:
            raise DecodeError("corrupt", f"plane of {len(plane)} symbols or more, expected {size}")
        return np.frombuffer(plane, np.uint8)


_zstd = _Zstd()


def decode(
    payload: bytes, seq: int, stamp_ns: int, dense: bool, beam_elevations_rad: NDArray[np.float32]
) -> FeatureFrame:
    """As splitslam.codec.decode, of a payload that begins with VERSION."""
    if len(payload) < _FIXED + _CRC.size:
        raise DecodeError("corrupt", f"{len(payload)} bytes, expected at least {_FIXED + _CRC.size}")
    if payload[0] != VERSION:
        raise DecodeError("version", f"codec version {payload[0]}, expected {VERSION}")
    if _CRC.unpack_from(payload, len(payload) - _CRC.size)[0] != zlib.crc32(memoryview(payload)[: -_CRC.size]):
        raise DecodeError("corrupt", "checksum")
    _, flags, rings, columns, knot_count, n, step_um, per_column, raw_size = _HEADER.unpack_from(payload)
    lengths = _LENGTHS.unpack_from(payload, _FIXED - _LENGTHS.size)
    if rings != len(beam_elevations_rad) or not 0 < rings <= MAX_RINGS:
        raise DecodeError("corrupt", f"{rings} rings, expected {len(beam_elevations_rad)}")
    if not (2 <= knot_count <= motion_codec.MAX_KNOTS and n <= MAX_POINTS and columns > 0 and step_um > 0):
        raise DecodeError("corrupt", f"{knot_count} knots, {n} points, {columns} columns, step {step_um} um")
    if _FIXED + sum(lengths) + raw_size + _CRC.size != len(payload):
        raise DecodeError("corrupt", f"{len(payload)} bytes do not match the lengths inside")

    uniform = bool(flags & _UNIFORM_KNOTS)
    counts_and_knots = rings + motion_codec.integer_count(knot_count, uniform)
    sizes = (counts_and_knots, *[n] * (_PLANES - 1))
    ends = np.cumsum([_FIXED, *lengths])
    view = memoryview(payload)
    first, classes, *symbols = (
        _zstd.decompress(bytes(view[a:b]), size) for a, b, size in zip(ends[:-1], ends[1:], sizes, strict=True)
    )
    raw = np.frombuffer(payload, np.uint8, raw_size, int(ends[-1]))
    small = np.empty(counts_and_knots, np.int64)
    residuals = np.empty((kernels.ROWS, n), np.int32)
    bits = kernels.join(first, True, raw, 0, small)
    for row, signed in enumerate(_SIGNED):
        bits = kernels.join(symbols[row], signed, raw, bits, residuals[row]) if bits >= 0 else bits
    counts = small[:rings]
    if (bits + 7) // 8 != raw_size or np.any(counts < 0) or int(counts.sum()) != n:
        raise DecodeError("corrupt", "raw bits or points per ring")
    try:
        knots = motion_codec.knots_from_integers(knot_count, uniform, small[rings:])
        block = bytes(view[_HEADER.size : _HEADER.size + motion_codec.BLOCK.size])
        motion = motion_codec.unpack_motion(block, knots, bool(flags & _VELOCITY_KNOWN))
    except ValueError as error:
        raise DecodeError("corrupt", str(error)) from None

    ring = np.repeat(np.arange(rings, dtype=np.uint8), counts)
    points, column, t_offset_ns = np.empty((n, 3), np.float32), np.empty(n, np.uint16), np.empty(n, np.int32)
    directions = directions_of(columns, beam_elevations_rad, step_um)
    if not kernels.from_residuals(
        residuals, ring, per_column, table_of(knots, _SEGMENT_NS), directions, points, column, t_offset_ns
    ):
        raise DecodeError("corrupt", "a point outside of the image or of any range")
    everything = FeatureSet(points, ring, column, t_offset_ns, (classes & 15).astype(np.uint8) * np.uint8(17))
    is_corner = (classes & 16) != 0
    corners, surfs = _chosen(everything, is_corner), _chosen(everything, ~is_corner)
    return FeatureFrame(seq, stamp_ns, dense, motion, corners, surfs)


def _chosen(points: FeatureSet, chosen: NDArray[np.bool_]) -> FeatureSet:
    return FeatureSet(
        points.points_lidar[chosen],
        points.ring[chosen],
        points.column[chosen],
        points.t_offset_ns[chosen],
        points.intensity[chosen],
    )
