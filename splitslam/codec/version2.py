"""Feature codec, version 2: everything behind the first byte is one stream of the range coder, then CRC-32.

Layout: version (1 byte); stream; CRC-32 of all before (little-endian). In the stream, in order: what all points share
(`_SHARED`), motion with knots, points of each ring, the line of each ring, the points (_point_kernels).
"""

from __future__ import annotations

import struct
import zlib

import numpy as np
from numpy.typing import NDArray

from splitslam.codec import _beam_kernels, _point_kernels
from splitslam.codec.beams import Beams, measure, place
from splitslam.codec.coder import MOTION, OFFSETS, SLOPES, Coder
from splitslam.codec.lattice import find_drift
from splitslam.codec.limits import MAX_COLUMNS, MAX_POINTS, MAX_RINGS, DecodeError
from splitslam.codec.motion import code_motion
from splitslam.errors import DataError
from splitslam.features import FeatureFrame

VERSION = 2
_CRC = struct.Struct("<I")
# rings, rate and its sign, is there a lattice, drift, is intensity coded
_SHARED = (9, 31, 1, 1, 21, 1)
_USUAL = np.array([1800, 20_000])  # columns, step um: a bit each where they are these
_HALF_TURN = _point_kernels.TURN


def encode(frame: FeatureFrame, beam_elevations_rad: NDArray[np.float32], columns: int, step_m: float) -> bytes:
    """As splitslam.codec.encode."""
    n, rings = len(frame.corners) + len(frame.surfs), len(beam_elevations_rad)
    if n > MAX_POINTS:
        raise DataError("too_many_features", f"{n}, at most {MAX_POINTS}")
    if not 0 < rings <= MAX_RINGS or not 0 < columns <= MAX_COLUMNS:
        raise ValueError(f"{rings} rings x {columns} columns, at most {MAX_RINGS} x {MAX_COLUMNS}")
    step_um = round(step_m * 1e6)
    beams = measure(frame, beam_elevations_rad, columns, step_um)
    drift = find_drift(beams.counts, beams.points, beams.fractions, columns)
    lines = np.empty((rings, 2), np.int64)
    _beam_kernels.fit_lines(beams.counts, beams.points, lines)

    coder = Coder(np.empty(8192 + 48 * n, np.uint8), decoding=False)
    lattice = drift is not None, (drift or 0) + _HALF_TURN
    shared = np.array([rings, abs(beams.rate), beams.rate < 0, *lattice, frame.dense], np.int64)
    coder.fields(shared, _SHARED)
    coder.numbers(np.array([columns, step_um]) - _USUAL, MOTION)
    code_motion(coder, frame.motion)
    _point_kernels.code_counts(*coder.arrays, beams.counts)
    _point_kernels.code_lines(*coder.arrays, OFFSETS, SLOPES, lines)
    if not _code_points(coder, beams, lines, columns, shared):
        raise ValueError("a time is too far from its neighbours'")
    body = bytes([VERSION]) + coder.close()
    return body + _CRC.pack(zlib.crc32(body))


def decode(
    payload: bytes, seq: int, stamp_ns: int, dense: bool, beam_elevations_rad: NDArray[np.float32]
) -> FeatureFrame:
    """As splitslam.codec.decode, of a payload that begins with VERSION."""
    if len(payload) <= _CRC.size or _CRC.unpack_from(payload, len(payload) - _CRC.size)[0] != zlib.crc32(
        memoryview(payload)[: -_CRC.size]
    ):
        raise DecodeError("corrupt", "checksum")
    coder = Coder(np.array(memoryview(payload)[1 : -_CRC.size], np.uint8), decoding=True)
    shared = coder.fields(np.zeros(len(_SHARED), np.int64), _SHARED)
    rings, rate, negative = shared[:3].tolist()
    columns, step_um = (coder.numbers(np.zeros(2, np.int64), MOTION) + _USUAL).tolist()
    if rings != len(beam_elevations_rad) or not 0 < rings <= MAX_RINGS:
        raise DecodeError("corrupt", f"{rings} rings, expected {len(beam_elevations_rad)}")
    if not (0 < columns <= MAX_COLUMNS and 0 < step_um < 1 << 20):
        raise DecodeError("corrupt", f"{columns} columns, step {step_um} um")
    try:
        motion = code_motion(coder, None)
    except ValueError as error:
        raise DecodeError("corrupt", str(error)) from None
    counts, lines = np.zeros(rings, np.int64), np.zeros((rings, 2), np.int64)
    n = _point_kernels.code_counts(*coder.arrays, counts)
    if not 0 <= n <= MAX_POINTS:
        raise DecodeError("corrupt", f"{n} points, at most {MAX_POINTS}")
    _point_kernels.code_lines(*coder.arrays, OFFSETS, SLOPES, lines)
    points = np.zeros((7, n), np.int32)
    beams = Beams(counts, points, -rate if negative else rate, np.empty(0))
    if not _code_points(coder, beams, lines, columns, shared):
        raise DecodeError("corrupt", "a point outside of the image or of any range")
    coder.close()
    corners, surfs = place(beams, motion.knots, beam_elevations_rad, columns, step_um)
    return FeatureFrame(seq, stamp_ns, dense, motion, corners, surfs)


def _code_points(coder: Coder, beams: Beams, lines: NDArray[np.int64], columns: int, shared: NDArray[np.int64]) -> bool:
    lattice, drift, with_intensity = shared[3:].tolist()
    width = round(2.0 * np.pi / columns * (1 << 20))
    scales = np.array([columns, beams.rate, lattice, drift - _HALF_TURN, width, with_intensity], np.int64)
    now = np.empty(_point_kernels.NOW, np.int64)
    return bool(_point_kernels.code_points(*coder.arrays, beams.counts, scales, lines, beams.points, now))
