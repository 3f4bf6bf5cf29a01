"""Two ways to send a cloud of points without knowing how a LiDAR sees: Morton order with zstd, and Draco."""

from __future__ import annotations

import math

import DracoPy
import numpy as np
import zstandard
from numpy.typing import NDArray

STEP_M = 0.01
_ZSTD_LEVEL = 9
_DRACO_LEVEL = 7  # of 10: what its own tool takes
Points = NDArray[np.float32]


def encode_morton(points: Points) -> bytes:
    """(N, 3) points, m, in steps of 1 cm: sorted by Morton code, differences as byte planes, zstd."""
    steps = np.rint(points / STEP_M).astype(np.int32)
    steps = steps[np.argsort(_morton(steps), kind="stable")]
    delta = np.diff(steps, axis=0, prepend=np.zeros((1, 3), np.int32))
    zigzag = (delta << 1 ^ delta >> 31).astype("<u4")
    planes = np.ascontiguousarray(zigzag.T).view(np.uint8).reshape(3, -1, 4).transpose(0, 2, 1)
    return zstandard.ZstdCompressor(level=_ZSTD_LEVEL).compress(planes.tobytes())


def decode_morton(data: bytes) -> Points:
    """The points of encode_morton, in its order."""
    planes = np.frombuffer(zstandard.ZstdDecompressor().decompress(data), np.uint8).reshape(3, 4, -1)
    zigzag = np.ascontiguousarray(planes.transpose(0, 2, 1)).view("<u4")[..., 0]
    delta = (zigzag >> 1).astype(np.int32) ^ -(zigzag & 1).astype(np.int32)
    return (np.cumsum(delta, axis=1, dtype=np.int32).T * STEP_M).astype(np.float32)


def _morton(steps: NDArray[np.int32]) -> NDArray[np.uint64]:
    """(N,) interleaved bits of (N, 3) steps, 21 each."""
    code = np.zeros(len(steps), np.uint64)
    for axis in range(3):
        x = (steps[:, axis].astype(np.int64) + (1 << 20)).astype(np.uint64)
        for shift, mask in (
            (32, 0x1F00000000FFFF),
            (16, 0x1F0000FF0000FF),
            (8, 0x100F00F00F00F00F),
            (4, 0x10C30C30C30C30C3),
            (2, 0x1249249249249249),
        ):
            x = (x | x << np.uint64(shift)) & np.uint64(mask)
        code |= x << np.uint64(axis)
    return code


def encode_draco(points: Points) -> bytes:
    """(N, 3) points, m, in steps of 1 cm."""
    origin = points.min(axis=0)
    bits = max(1, math.ceil(math.log2(float((points - origin).max()) / STEP_M + 1)))
    return DracoPy.encode(
        points,
        quantization_bits=bits,
        compression_level=_DRACO_LEVEL,
        quantization_range=((1 << bits) - 1) * STEP_M,
        quantization_origin=origin.tolist(),
    )


def decode_draco(data: bytes) -> Points:
    """The points of encode_draco, in its order."""
    return np.asarray(DracoPy.decode(data).points, np.float32)


def thinned(points: Points, voxel_m: float) -> Points:
    """The centroids of the occupied voxels."""
    cell = np.floor(points / voxel_m).astype(np.int64) + (1 << 20)
    _, inverse = np.unique(cell[:, 0] << 42 | cell[:, 1] << 21 | cell[:, 2], return_inverse=True)
    count = np.bincount(inverse)
    sums = [np.bincount(inverse, weights=points[:, axis]) for axis in range(3)]
    return (np.stack(sums, axis=1) / count[:, None]).astype(np.float32)
