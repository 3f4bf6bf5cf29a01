"""A keyframe's cloud as it is stored: quantised, compressed, versioned."""

from __future__ import annotations

import struct

import numpy as np
import zstandard
from numpy.typing import NDArray

from splitslam.errors import DataError

STEP_M = 0.005
_HEADER = struct.Struct("<2sHII")
_MAGIC = b"KC"
_VERSION = 1
_POINT_BYTES = 3 * 4 + 1
_MAX_POINTS = 1 << 20


def encode_cloud(
    corners_lidar: NDArray[np.float32],
    surfs_lidar: NDArray[np.float32],
    corners_intensity: NDArray[np.uint8],
    surfs_intensity: NDArray[np.uint8],
) -> bytes:
    """Points (N, 3), m, frame `lidar`, in steps of 5 mm, and intensity (N,) of both classes."""
    points = np.concatenate([corners_lidar, surfs_lidar])
    intensity = np.concatenate([corners_intensity, surfs_intensity])
    steps = np.rint(points / STEP_M).astype("<i4")
    delta = np.diff(steps, axis=0, prepend=np.zeros((1, 3), np.int32)).astype("<i4")
    # byte planes: the high bytes of neighbouring points' differences are nearly all alike
    body = np.ascontiguousarray(delta.T).view(np.uint8).reshape(3, -1, 4).transpose(0, 2, 1).tobytes()
    packed = zstandard.ZstdCompressor(level=3, write_checksum=True).compress(body + intensity.tobytes())
    return _HEADER.pack(_MAGIC, _VERSION, len(corners_lidar), len(surfs_lidar)) + packed


def decode_cloud(data: bytes) -> tuple[NDArray[np.float32], NDArray[np.uint8], NDArray[np.bool_]]:
    """points_lidar (N, 3) float32, m; intensity (N,) uint8; is_corner (N,) bool.

    Raises DataError("corrupt") for anything that encode_cloud did not write.
    """
    if len(data) < _HEADER.size:
        raise DataError("corrupt", "keyframe cloud shorter than its header")
    magic, version, corners, surfs = _HEADER.unpack_from(data)
    n = corners + surfs
    if magic != _MAGIC or version != _VERSION or n > _MAX_POINTS:
        raise DataError("corrupt", "not a keyframe cloud of version 1")
    try:
        # what the frame says of its size is what the decompressor would allocate
        if zstandard.frame_content_size(data[_HEADER.size :]) != n * _POINT_BYTES:
            raise DataError("corrupt", "keyframe cloud has another length than its header says")
        body = zstandard.ZstdDecompressor().decompress(data[_HEADER.size :], max_output_size=n * _POINT_BYTES)
    except zstandard.ZstdError as error:
        raise DataError("corrupt", f"keyframe cloud: {error}") from error
    if len(body) != n * _POINT_BYTES:
        raise DataError("corrupt", "keyframe cloud has another length than its header says")
    planes = np.frombuffer(body, np.uint8, 12 * n).reshape(3, 4, n).transpose(0, 2, 1)
    delta = np.ascontiguousarray(planes).view("<i4").reshape(3, n).T
    points = (np.cumsum(delta, axis=0, dtype=np.int32) * STEP_M).astype(np.float32)
    return points, np.frombuffer(body, np.uint8, n, 12 * n).copy(), np.arange(n) < corners
