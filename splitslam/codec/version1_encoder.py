"""The encoder of codec version 1: for services of 0.1.0, which read nothing else (edge_agent/recoding.py)."""

from __future__ import annotations

import zlib

import numpy as np
import zstandard
from numpy.typing import NDArray

from splitslam import _motion_kernels, se3
from splitslam.codec import _version1_encoder_kernels as kernels
from splitslam.codec import version1, version1_motion
from splitslam.codec._beam_kernels import column_rate
from splitslam.codec._point_kernels import CLASS, COLUMN, INTENSITY
from splitslam.codec.beams import directions_of, merged, table_of
from splitslam.features import FeatureFrame, Knots, Motion

STEP_M = 0.01  # what 0.1.0 wrote; points that were rounded once to 2 cm are not moved as far again
_LARGEST_HALF = 65_504.0


def encode(
    frame: FeatureFrame, beam_elevations_rad: NDArray[np.float32], columns: int, step_m: float = STEP_M
) -> bytes:
    """The frame's payload in version 1. Its knots are sampled at 32 times, which is all that version 1 had.

    ValueError for a frame that breaks FeatureSet's contract.
    """
    rings = len(beam_elevations_rad)
    counts, cells, points, t_offset_ns = merged(frame, rings, columns)
    n, column = len(points), cells[COLUMN].astype(np.uint16)
    ring = np.repeat(np.arange(rings, dtype=np.uint8), counts)
    knots = _at_32_times(frame.motion.knots)
    per_column = column_rate(counts, cells, t_offset_ns, 1e8 / columns)
    step_um = round(step_m * 1e6)
    directions = directions_of(columns, beam_elevations_rad, step_um)
    residuals = np.empty((kernels.ROWS, n), np.int32)
    if not kernels.to_residuals(
        points, ring, column, t_offset_ns, per_column, table_of(knots, version1._SEGMENT_NS), directions, residuals
    ):
        raise ValueError("a point is not finite or too far away")

    uniform, small = _knot_integers(knots)
    small = np.concatenate([counts, small])
    raw = np.zeros(16 * n + 4 * len(small) + 8, np.uint8)
    symbols = np.empty((kernels.ROWS, n), np.uint8)
    first = np.empty(len(small), np.uint8)
    bits = kernels.split(small, True, first, raw, 0)
    for row, signed in enumerate(version1._SIGNED):
        bits = kernels.split(residuals[row], signed, symbols[row], raw, bits) if bits >= 0 else bits
    if bits < 0:
        raise ValueError("a time, a ring's number of points or a knot is too large")
    classes = 16 * cells[CLASS] + cells[INTENSITY]
    planes = [_compressed(plane.astype(np.uint8, copy=False).tobytes()) for plane in (first, classes, *symbols)]
    flags = version1._VELOCITY_KNOWN * frame.motion.velocity_known | version1._UNIFORM_KNOTS * uniform
    tail = raw[: (bits + 7) // 8].tobytes()
    head = (version1.VERSION, flags, rings, columns, len(knots.offsets_ns), n, step_um, per_column, len(tail))
    body = b"".join(
        [
            version1._HEADER.pack(*head),
            _motion_block(frame.motion),
            version1._LENGTHS.pack(*map(len, planes)),
            *planes,
            tail,
        ]
    )
    return body + version1._CRC.pack(zlib.crc32(body))


def _compressed(plane: bytes) -> bytes:
    parameters = zstandard.ZstdCompressionParameters.from_level(
        3, format=zstandard.FORMAT_ZSTD1_MAGICLESS, write_content_size=False, write_checksum=False
    )
    return zstandard.ZstdCompressor(compression_params=parameters).compress(plane)


def _at_32_times(knots: Knots) -> Knots:
    if len(knots.offsets_ns) <= version1_motion.MAX_KNOTS:
        return knots
    first, last = int(knots.offsets_ns[0]), int(knots.offsets_ns[-1])
    times = first + (last - first) * np.arange(32, dtype=np.int64) // 31
    rotation, translation = np.empty((32, 3)), np.empty((32, 3))
    _motion_kernels.resample(knots.offsets_ns, knots.rotation, knots.translation_m, times, rotation, translation)
    return Knots(times, rotation, translation)


def _knot_integers(knots: Knots) -> tuple[bool, NDArray[np.int64]]:
    offsets = knots.offsets_ns
    even = offsets[0] + (offsets[-1] - offsets[0]) * np.arange(len(offsets), dtype=np.int64) // (len(offsets) - 1)
    uniform = bool(np.array_equal(offsets, even))
    times = offsets[[0, -1]] if uniform else offsets
    times = np.diff(np.diff(times // version1_motion._TIME_STEP_NS, prepend=0), prepend=0)
    scaled = (
        knots.rotation / version1_motion.ROTATION_STEP_RAD,
        knots.translation_m / version1_motion.TRANSLATION_STEP_M,
    )
    steps = np.rint(np.hstack(scaled)).astype(np.int64)
    second = np.diff(np.diff(steps, axis=0, prepend=0), axis=0, prepend=0)
    return uniform, np.concatenate([times, second.T.reshape(-1)])


def _motion_block(motion: Motion) -> bytes:
    floats = np.concatenate(
        [
            se3.so3_log(motion.T_prev_lidar[:3, :3]),
            motion.T_prev_lidar[:3, 3],
            motion.velocity_lidar_mps,
            motion.gravity_lidar,
            np.minimum(np.sqrt(np.diagonal(motion.covariance)), _LARGEST_HALF),
            [min(motion.gravity_sigma_rad, _LARGEST_HALF)],
        ]
    )
    return version1_motion.BLOCK.pack(*floats)
