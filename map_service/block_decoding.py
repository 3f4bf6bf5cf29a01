"""Blocks of stored scans, read: the reverse of block_encoding.py, which says what they are."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from map_service import _way_kernels as kernels
from map_service.block_encoding import GAINS, LOWER, MOST_SCANS, runs
from map_service.columns import ColumnReader, Ints
from map_service.fidelity import MICRO
from map_service.pose_arrays import identities, inverse, moved
from map_service.scans import NO_KEYFRAME, Scans
from splitslam.errors import DataError

Array = NDArray[np.float64]


def decode_block(data: bytes, anchors: Mapping[int, Array]) -> Scans:
    """Raises DataError("corrupt") for what encode_block did not write, and for a keyframe without an anchor."""
    columns = ColumnReader(data)
    steps = np.asarray(columns.take(4) * MICRO, np.float64)
    thins, n, first_seq, origin_ns = columns.take(4).tolist()
    if not 0 < n <= MOST_SCANS:
        raise DataError("corrupt", f"a block of {n} scans")
    seq = first_seq + np.concatenate([[0], np.cumsum(columns.take(n - 1) + 1)])
    keyframe, state = np.cumsum(columns.take(n)), columns.take(n)
    mapped = keyframe != NO_KEYFRAME
    stamp_ns = np.full(n, origin_ns, np.int64)
    stamp_ns[~mapped] += columns.take(int((~mapped).sum()))
    rejected = np.array(["" if there else columns.text() for there in mapped], "U64")
    poses = np.tile(np.eye(4), (3, n, 1, 1))
    factor, left_out = np.full((n, 6, 6), np.nan), np.zeros(n, bool)
    if mapped.any():
        read = _take_mapped(columns, seq[mapped], keyframe[mapped], anchors, steps, thins=bool(thins))
        stamp_ns[mapped] += read.stamp_ns
        poses[:, mapped], factor[mapped], left_out[mapped] = read.poses, read.factor, ~read.kept
    if not (np.isfinite(poses).all() and (np.diff(seq) > 0).all()):
        raise DataError("corrupt", "a block of scans that are nowhere")
    answers = poses[1], poses[2], factor, rejected, left_out
    return Scans(seq, stamp_ns, state, keyframe, poses[0], *answers)


@dataclass(frozen=True, slots=True, eq=False)
class _Mapped:
    """Of m scans: stamps (m,) since the origin, poses (3, m, 4, 4) as Scans has them, factors, which were kept."""

    stamp_ns: Ints
    poses: Array
    factor: Array
    kept: NDArray[np.bool_]


def _take_mapped(
    columns: ColumnReader, seq: Ints, keyframe: Ints, anchors: Mapping[int, Array], steps: Array, *, thins: bool
) -> _Mapped:
    m = len(seq)
    starts, run = runs(keyframe)
    if lost := [k for k in keyframe[starts].tolist() if k not in anchors]:
        raise DataError("corrupt", f"keyframe {lost[0]} has no anchor")
    fixed, pose_steps = np.array([anchors[k] for k in keyframe[starts].tolist()]), np.repeat(steps[:2], 3)
    T_map_keyframe = moved(fixed, _take_held(columns, len(starts), pose_steps))
    off, odom = _take_held(columns, m, pose_steps), _take_held(columns, m, pose_steps)
    factor = _take_covariances(columns, m, steps[2:])
    kept = columns.take(m) != 0 if thins else np.ones(m, bool)
    if not (kept[0] and kept[-1]):
        raise DataError("corrupt", "a way without its ends")
    stamp_ns = np.zeros(m, np.int64)
    stamp_ns[kept] = np.cumsum(np.cumsum(columns.take(int(kept.sum()))))
    stamp_ns[~kept] = _between(seq, stamp_ns, kept)
    times_s = (stamp_ns - stamp_ns[0]) * 1e-9
    way = identities(m)
    way[kept] = _take_way(columns, times_s[kept], steps[:2])
    if not np.isfinite(way).all() or (np.diff(stamp_ns) < 0).any():
        raise DataError("corrupt", "a way that leads nowhere")
    kernels.fill_way(way, times_s, kept)
    T_keyframe_lidar = inverse(T_map_keyframe)[run] @ way
    T_map_odom = moved(identities(m), odom)
    return _Mapped(stamp_ns, np.array([T_keyframe_lidar, moved(way, off), T_map_odom]), factor, kept)


def _between(seq: Ints, stamp_ns: Ints, kept: NDArray[np.bool_]) -> Ints:
    """Stamps of scans that were not kept, by their numbers."""
    return np.rint(np.interp(seq[~kept], seq[kept], stamp_ns[kept] - stamp_ns[0])).astype(np.int64) + stamp_ns[0]


def _take_way(columns: ColumnReader, times_s: Array, steps: Array) -> Array:
    (gains,) = columns.take(1)
    if not 0 <= gains < len(GAINS):
        raise DataError("corrupt", f"a way of kind {gains}")
    numbers = np.column_stack([columns.take(len(times_s)) for _ in range(6)])
    poses = np.empty((len(times_s), 4, 4))
    kernels.decode_way(numbers, times_s, steps, GAINS[gains], poses)
    return poses


def _take_covariances(columns: ColumnReader, m: int, bounds: Array) -> Array:
    known = columns.take(m) != 0
    factor = np.full((m, 6, 6), np.nan)
    if known.any():
        shapes = _take_held(columns, int(known.sum()), np.repeat(bounds / 2.0, [6, 15]))
        factor[known] = _factors(shapes)
    return factor


def _factors(shapes: Array) -> Array:
    """The reverse of `_shapes`: what rounding has made too long for its sigma is shortened."""
    rows = np.zeros((len(shapes), 6, 6))
    rows[:, *LOWER] = shapes[:, 6:]
    rows /= np.maximum(np.linalg.norm(rows, axis=2, keepdims=True), 1.0)
    diagonal = np.arange(6)
    rows[:, diagonal, diagonal] = np.sqrt(np.maximum(1.0 - np.einsum("nij,nij->ni", rows, rows), 0.0))
    with np.errstate(over="ignore"):
        return rows * np.exp(shapes[:, :6])[:, :, None]


def _take_held(columns: ColumnReader, n: int, steps: Array) -> Array:
    """(n, c) with steps (c,)."""
    (count,) = columns.take(1)
    if not 0 < count <= n:
        raise DataError("corrupt", f"{count} changes of {n}")
    at = np.concatenate([[0], np.cumsum(columns.take(int(count) - 1))])
    numbers = np.column_stack([np.cumsum(columns.take(int(count))) for _ in steps])
    if (np.diff(at) <= 0).any() or at[-1] >= n:
        raise DataError("corrupt", "changes out of order")
    return np.repeat(numbers, np.diff(at, append=n), axis=0) * steps
