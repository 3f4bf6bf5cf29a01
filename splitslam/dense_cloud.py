"""A keyframe's whole scan, deskewed: what the robot keeps on its disk, sends, and the service stores, byte for byte.

Layout, little-endian: head (magic, rings, parts, points, seq, stamp_ns), beam elevations (rings float32, rad), length
of each part (uint32), the parts, CRC-32 of all before. A part is a payload of the feature codec with the points of some
rings, all of them surfs: the codec takes 131,072 points at once, a sensor of 128 x 2048 has twice as many. The beams
travel along, so that nothing else is needed to read it. `check` looks at the layout and needs no codec.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitslam.errors import DataError
from splitslam.features import FeatureFrame, FeatureSet, Motion

MAX_BYTES = 4 << 20  # eight times a scan of 128 x 2048
_HEAD = struct.Struct("<4sHHIQq")
_CRC = struct.Struct("<I")
_MAGIC = b"SSd1"
_PART_POINTS = 1 << 17  # splitslam.codec.MAX_POINTS, which whoever only checks does not load
_MAX_RINGS = 256


@dataclass(frozen=True, slots=True, eq=False)
class WholeScan:
    """What there is to encode. points: every return of the range image, deskewed by motion.knots, by ring and column.

    beam_elevations_rad: (rings,) float32. columns: of the image.
    """

    seq: int
    stamp_ns: int
    motion: Motion
    points: FeatureSet
    beam_elevations_rad: NDArray[np.float32]
    columns: int


@dataclass(frozen=True, slots=True)
class Head:
    """What a cloud says of itself."""

    seq: int
    stamp_ns: int
    points: int


def encode(scan: WholeScan, step_m: float) -> bytes:
    """Each point within step_m / 2 along three axes, intensity in 16 steps. DataError or ValueError: not encodable."""
    from splitslam import codec

    beams = np.ascontiguousarray(scan.beam_elevations_rad, "<f4")
    payloads = []
    for part in _parts(scan.points, len(beams)):
        nothing = part_of(part, 0, 0)
        frame = FeatureFrame(scan.seq, scan.stamp_ns, True, scan.motion, corners=nothing, surfs=part)
        payloads.append(codec.encode(frame, beams, scan.columns, step_m))
    head = _HEAD.pack(_MAGIC, len(beams), len(payloads), len(scan.points), scan.seq, scan.stamp_ns)
    lengths = struct.pack(f"<{len(payloads)}I", *map(len, payloads))
    body = b"".join((head, beams.tobytes(), lengths, *payloads))
    return body + _CRC.pack(zlib.crc32(body))


def check(data: bytes) -> Head:
    """Whether it is whole and laid out as it should be. Raises DataError("corrupt")."""
    head, _, _ = _layout(data)
    return head


def decode(data: bytes) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """points_lidar (N, 3) float32, m, at the scan's reference time; intensity (N,) uint8. Raises DataError."""
    from splitslam import codec

    head, beams, payloads = _layout(data)
    parts = [codec.decode(part, head.seq, head.stamp_ns, True, beams).surfs for part in payloads]
    points = np.concatenate([np.empty((0, 3), np.float32), *(part.points_lidar for part in parts)])
    if len(points) != head.points:
        raise DataError("corrupt", f"dense cloud of {len(points)} points, its head says {head.points}")
    return points, np.concatenate([np.empty(0, np.uint8), *(part.intensity for part in parts)])


def in_map(data: bytes, T_map_lidar: NDArray[np.float64]) -> NDArray[np.float32]:
    """(N, 4) little-endian float32: x y z, m, in `map`, and intensity; T_map_lidar (4, 4). Raises DataError."""
    points, intensity = decode(data)
    moved = points.astype(np.float64) @ T_map_lidar[:3, :3].T + T_map_lidar[:3, 3]
    return np.column_stack([moved, intensity]).astype("<f4")


def part_of(points: FeatureSet, first: int, end: int) -> FeatureSet:
    """Points [first, end), as a view."""
    some = slice(first, end)
    return FeatureSet(
        points.points_lidar[some], points.ring[some], points.column[some], points.t_offset_ns[some],
        points.intensity[some],
    )  # fmt: skip


def _parts(points: FeatureSet, rings: int) -> Iterator[FeatureSet]:
    """As many whole rings at a time as the codec takes; one ring has at most 65,536 points."""
    starts = np.searchsorted(points.ring, np.arange(rings + 1)).tolist()  # ring r is [r]:[r + 1]
    first = 0
    for ring in range(rings):
        if starts[ring + 1] - starts[first] > _PART_POINTS:
            yield part_of(points, starts[first], starts[ring])
            first = ring
    yield part_of(points, starts[first], starts[rings])


def _layout(data: bytes) -> tuple[Head, NDArray[np.float32], list[bytes]]:
    """Head, beams and parts. Raises DataError."""
    if not _HEAD.size + _CRC.size <= len(data) <= MAX_BYTES:
        raise DataError("corrupt", f"dense cloud of {len(data)} bytes, expected up to {MAX_BYTES}")
    if _CRC.unpack_from(data, len(data) - _CRC.size)[0] != zlib.crc32(memoryview(data)[: -_CRC.size]):
        raise DataError("corrupt", "dense cloud: checksum")
    magic, rings, parts, points, seq, stamp_ns = _HEAD.unpack_from(data)
    if magic != _MAGIC or not 0 < rings <= _MAX_RINGS or points > parts * _PART_POINTS:
        raise DataError("corrupt", "not a dense cloud of version 1")
    lengths_at = _HEAD.size + 4 * rings
    offset = lengths_at + 4 * parts
    if offset > len(data) - _CRC.size:
        raise DataError("corrupt", "dense cloud: shorter than its head says")
    lengths = struct.unpack_from(f"<{parts}I", data, lengths_at)
    if offset + sum(lengths) != len(data) - _CRC.size:
        raise DataError("corrupt", "dense cloud: its parts are not as long as it says")
    beams = np.frombuffer(data, "<f4", rings, _HEAD.size)
    if not np.all(np.abs(beams) <= math.pi / 2):  # also false for NaN
        raise DataError("corrupt", "dense cloud: a beam beyond +-pi/2")
    payloads = []
    for length in lengths:
        payloads.append(data[offset : offset + length])
        offset += length
    return Head(seq, stamp_ns, points), beams, payloads
