"""Feature codec, version 1: a FeatureFrame as a few kilobytes.

Points are coded where the sensor saw them: ring, column and time follow from the scan order, what is left is a range
along the ring's direction and two small residuals across it, all in whole steps. The decoder puts the points back and
moves them by the frame's own knots, so it has both the deskewed point and the beam it came from.

Layout (little-endian): header (`_HEADER`), plane lengths, zstd planes of symbols, raw bits, CRC-32 of all before.
Planes: small integers (points of each ring, knots), class and intensity, column, range, azimuth, elevation, time.
"""

from __future__ import annotations

import struct
import threading
import zlib
from functools import lru_cache

import numpy as np
import zstandard
from numpy.typing import NDArray

from splitslam import _codec_kernels as kernels
from splitslam import _motion_codec as motion_codec
from splitslam._motion_codec import quantise_knots
from splitslam.errors import DataError
from splitslam.features import FeatureFrame, FeatureSet, Knots
from splitslam.motion_table import motion_table

__all__ = ["CODEC_VERSION", "MAX_POINTS", "DecodeError", "decode", "encode", "quantise_knots"]

CODEC_VERSION = 1
MAX_POINTS = 1 << 17  # five times the features of a dense 128 x 2048 image; bounds what a decoder allocates
_MAX_RINGS = 256
_SIGNED = (False, True, True, True, True)  # rows of the residuals
_PLANES = 2 + len(_SIGNED)
_VELOCITY_KNOWN, _UNIFORM_KNOTS = 1, 2
# version, flags, rings, columns, knots, points, step um, ns per column / 256, raw bytes
_HEADER = struct.Struct("<BBHHHIIiI")
_LENGTHS = struct.Struct(f"<{_PLANES}I")
_CRC = struct.Struct("<I")
_FIXED = _HEADER.size + motion_codec.BLOCK.size + _LENGTHS.size


class DecodeError(DataError):
    """The payload is not a frame of this codec; reason `corrupt` or `version`."""


class _Zstd(threading.local):
    """Compression contexts are not shared between threads."""

    def __init__(self) -> None:
        magicless = zstandard.FORMAT_ZSTD1_MAGICLESS
        parameters = zstandard.ZstdCompressionParameters.from_level(
            3, format=magicless, write_content_size=False, write_checksum=False
        )
        self.compress = zstandard.ZstdCompressor(compression_params=parameters).compress
        self._decompressor = zstandard.ZstdDecompressor(format=magicless, max_window_size=1 << 23)

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


def encode(frame: FeatureFrame, beam_elevations_rad: NDArray[np.float32], columns: int, step_m: float = 0.01) -> bytes:
    """The frame's payload; seq, stamp and dense travel outside of it. The same frame gives the same bytes.

    beam_elevations_rad: (rings,), what the ring numbers mean; columns: of the image. Every decoded point lies within
    step_m / 2 of the frame's along each of three orthogonal axes. Raises ValueError for a frame that breaks the
    contract of FeatureSet (order, ring, column, finite points), which is a programmer's error, and DataError
    (`too_many_features`) for one with more than MAX_POINTS features.
    """
    corners, surfs = frame.corners, frame.surfs
    n, rings = len(corners) + len(surfs), len(beam_elevations_rad)
    if n > MAX_POINTS:
        raise DataError("too_many_features", f"{n}, at most {MAX_POINTS}")
    if rings > _MAX_RINGS:
        raise ValueError(f"{rings} rings, at most {_MAX_RINGS}")
    order = np.empty(n, np.int32)
    if not kernels.merge(corners.ring, corners.column, surfs.ring, surfs.column, order):
        raise ValueError("features are not sorted by ring and column")
    points, ring, column, t_offset_ns, intensity = (
        np.concatenate([getattr(corners, name), getattr(surfs, name)])[order]
        for name in ("points_lidar", "ring", "column", "t_offset_ns", "intensity")
    )
    if n and (int(ring[-1]) >= rings or int(column.max()) >= columns):
        raise ValueError(f"ring or column outside of {rings} x {columns}")
    knots = frame.motion.knots
    per_column = _column_rate(ring, column, t_offset_ns)
    step_um = round(step_m * 1e6)
    table, directions = _table(knots), _directions(columns, beam_elevations_rad, step_um)
    residuals = np.empty((kernels.ROWS, n), np.int32)
    if not kernels.to_residuals(points, ring, column, t_offset_ns, per_column, table, directions, residuals):
        raise ValueError("a point is not finite or too far away")

    uniform, small = motion_codec.knots_to_integers(knots)
    small = np.concatenate([np.bincount(ring, minlength=rings), small])
    raw = np.zeros(16 * n + 4 * len(small) + 8, np.uint8)
    symbols = np.empty((kernels.ROWS, n), np.uint8)
    first = np.empty(len(small), np.uint8)
    bits = kernels.split(small, True, first, raw, 0)
    for row, signed in enumerate(_SIGNED):
        bits = kernels.split(residuals[row], signed, symbols[row], raw, bits) if bits >= 0 else bits
    if bits < 0:
        raise ValueError("a time, a ring's number of points or a knot is too large")
    classes = (order < len(corners)) * np.uint8(16) | (intensity.astype(np.uint16) + 8) // 17
    planes = [_zstd.compress(plane.astype(np.uint8, copy=False).tobytes()) for plane in (first, classes, *symbols)]
    flags = _VELOCITY_KNOWN * frame.motion.velocity_known | _UNIFORM_KNOTS * uniform
    tail = raw[: (bits + 7) // 8].tobytes()
    knot_count = len(knots.offsets_ns)
    body = b"".join(
        [
            _HEADER.pack(CODEC_VERSION, flags, rings, columns, knot_count, n, step_um, per_column, len(tail)),
            motion_codec.pack_motion(frame.motion),
            _LENGTHS.pack(*map(len, planes)),
            *planes,
            tail,
        ]
    )
    return body + _CRC.pack(zlib.crc32(body))


def decode(
    payload: bytes, seq: int, stamp_ns: int, dense: bool, beam_elevations_rad: NDArray[np.float32]
) -> FeatureFrame:
    """The frame of a payload; t_offset_ns within 50 us, intensity in 16 steps. DecodeError for anything else."""
    if len(payload) < _FIXED + _CRC.size:
        raise DecodeError("corrupt", f"{len(payload)} bytes, expected at least {_FIXED + _CRC.size}")
    if payload[0] != CODEC_VERSION:
        raise DecodeError("version", f"codec version {payload[0]}, expected {CODEC_VERSION}")
    if _CRC.unpack_from(payload, len(payload) - _CRC.size)[0] != zlib.crc32(memoryview(payload)[: -_CRC.size]):
        raise DecodeError("corrupt", "checksum")
    _, flags, rings, columns, knot_count, n, step_um, per_column, raw_size = _HEADER.unpack_from(payload)
    lengths = _LENGTHS.unpack_from(payload, _FIXED - _LENGTHS.size)
    if rings != len(beam_elevations_rad) or not 0 < rings <= _MAX_RINGS:
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
    directions = _directions(columns, beam_elevations_rad, step_um)
    if not kernels.from_residuals(residuals, ring, per_column, _table(knots), directions, points, column, t_offset_ns):
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


def _column_rate(ring: NDArray[np.uint8], column: NDArray[np.uint16], t_offset_ns: NDArray[np.int32]) -> int:
    """Time from a column to the next, ns / 256, negative for a sensor that turns clockwise."""
    rates = np.empty(len(ring))
    count = kernels.neighbour_rates(ring, column, t_offset_ns, rates)
    if count == 0:
        return 0
    rate = kernels.mean_rate(ring, column, t_offset_ns, float(np.median(rates[:count])))
    return int(np.clip(round(rate * 256.0), -(2**31), 2**31 - 1))


def _table(knots: Knots) -> tuple[NDArray[np.int64], NDArray[np.float32], NDArray[np.float32]]:
    table = motion_table(knots)
    return table.breaks_ns, table.base, table.slope


def _directions(
    columns: int, beam_elevations_rad: NDArray[np.float32], step_um: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """What the kernels need to turn (ring, column) into a direction, and the step in metres."""
    elevations = np.asarray(beam_elevations_rad, np.float64)
    return _azimuths(columns), np.stack([np.cos(elevations), np.sin(elevations)], axis=1), step_um * 1e-6


@lru_cache(maxsize=8)
def _azimuths(columns: int) -> NDArray[np.float64]:
    """(columns, 2) cos and sin of the columns' middles: LIO-SAM's image has +x in the middle, counter-clockwise."""
    azimuth = (np.arange(columns) - columns // 2) * (2.0 * np.pi / columns)
    return np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
