"""Stored scans in blocks: what a run of them says, in a few bytes a scan, and next to none where nothing happens.

A scan's pose is told twice: from its keyframe, which corrections move, and in `map` as it was answered. Each keyframe
has an anchor, a pose that is written once and never moves. Where the map had keyframe k while scans were answered is

    T_map_k = anchor_k moved by its shift          (held: as before, until it is off by more than its bound)
    X_i     = T_map_k T_k_lidar(i)                 (the way, as numbers against its prediction: _way_kernels.py)
    answered_i = X_i moved by what was off         (held)

so the way goes on smoothly from keyframe to keyframe, and on a map that stands still it is all there is to tell.
T_map_odom and covariances are held as well.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from map_service import _way_kernels as kernels
from map_service.columns import ColumnWriter, Ints
from map_service.fidelity import Fidelity
from map_service.pose_arrays import apart, identities, inverse, moved
from map_service.scans import NO_KEYFRAME, Scans
from splitslam.errors import DataError

Array = NDArray[np.float64]
MOST_SCANS = 4096
# Of the filter that expects the next pose: of motions that are believed at once, that are smoothed, of standing.
GAINS = np.array([[1.0, 1.0], [0.6, 0.25], [0.3, 0.05]])
LOWER = np.tril_indices(6, -1)
_QUICK, _HARD = 12, 19  # levels of compression: 0.1 and 3 ms, 7 % apart; every scan is thinned once in 4,096
_LEAST_SIGMA = 1e-9  # rad or m
_FARTHEST_M = 1e9


def first_seen(scans: Scans) -> dict[int, Array]:
    """Where `map` had each keyframe (4, 4) when a scan was first told by it: its anchor, unless it has one already."""
    there = scans.part(scans.mapped)
    numbers, at = np.unique(there.keyframe, return_index=True)
    return dict(zip(numbers.tolist(), _keyframes(there, at), strict=True))


def _keyframes(scans: Scans, at: Ints) -> Array:
    """(r, 4, 4): T_map_keyframe by the answers of scans `at` (r,)."""
    return scans.T_map_lidar[at] @ inverse(scans.T_keyframe_lidar[at])


def encode_block(scans: Scans, anchors: Mapping[int, Array], fidelity: Fidelity) -> tuple[bytes, int]:
    """1 to MOST_SCANS scans; anchors (4, 4) of all their keyframes. Also how many scans are left without a pose.

    Raises DataError for poses that are nowhere, and stamps of mapped scans that do not rise.
    """
    out = ColumnWriter()
    out.add(fidelity.told)
    out.add(np.array([fidelity.thins, len(scans), scans.seq[0], scans.stamp_ns[0]]))
    out.add(np.diff(scans.seq) - 1)
    out.add(np.diff(scans.keyframe, prepend=0))
    out.add(scans.state)
    there, lost = scans.part(scans.mapped), scans.part(~scans.mapped)
    out.add(lost.stamp_ns - scans.stamp_ns[0])
    for reason in lost.rejected:
        out.text(str(reason))
    left_out = _put_mapped(out, there, int(scans.stamp_ns[0]), anchors, fidelity) if len(there) else 0
    return out.packed(_HARD if fidelity.thins else _QUICK), left_out


def _put_mapped(out: ColumnWriter, scans: Scans, origin_ns: int, anchors: Mapping[int, Array], f: Fidelity) -> int:
    if not max(np.abs(scans.T_map_lidar).max(), np.abs(scans.T_keyframe_lidar).max()) < _FARTHEST_M:
        raise DataError("corrupt", "a pose that is nowhere")
    if (np.diff(scans.stamp_ns) <= 0).any():
        raise DataError("corrupt", "stamps that do not rise")
    rotation_rad, position_m, *_ = f.read_as
    steps = np.repeat([rotation_rad, position_m], 3)
    starts, run = runs(scans.keyframe)
    fixed = np.array([anchors[k] for k in scans.keyframe[starts].tolist()])
    shifts = _held(out, apart(fixed, _keyframes(scans, starts)), steps, steps)
    way = moved(fixed, shifts)[run] @ scans.T_keyframe_lidar
    _held(out, apart(way, scans.T_map_lidar), 2.0 * steps, steps)
    _held(out, apart(identities(len(way)), scans.T_map_odom), steps, steps)
    _put_covariances(out, scans.factor, f)
    times_s, kept = (scans.stamp_ns - scans.stamp_ns[0]) * 1e-9, np.ones(len(way), bool)
    if f.thins:
        limits = np.array([f.within_rad, f.within_m, f.within_s])
        kernels.thin_way(way, times_s, scans.seq.astype(np.float64), limits, kept)
        out.add(kept)
    out.add(_differences(scans.stamp_ns[kept] - origin_ns))
    _put_way(out, way[kept], times_s[kept], steps[[0, 3]])
    return int((~kept).sum())


def _put_way(out: ColumnWriter, way: Array, times_s: Array, steps: Array) -> None:
    """By the gains that make it smallest."""
    tried = []
    for number, gains in enumerate(GAINS):
        numbers, coded = np.empty((len(way), 6), np.int64), np.empty_like(way)
        bits = kernels.code_way(way, times_s, steps, gains, numbers, coded)
        tried.append((bits, number, numbers))
    _, number, numbers = min(tried, key=lambda one: one[:2])
    out.add(np.array([number]))
    for column in numbers.T:
        out.add(column)


def _put_covariances(out: ColumnWriter, factor: Array, f: Fidelity) -> None:
    known = ~np.isnan(factor[:, 0, 0])
    out.add(known)
    if known.any():
        bounds = np.repeat(f.read_as[2:], [6, 15])
        _held(out, _shapes(factor[known]), bounds, bounds / 2.0)


def _shapes(factor: Array) -> Array:
    """(n, 21) of Cholesky factors (n, 6, 6): logarithms of the six sigmas, and what is below the diagonal over them."""
    sigmas = np.maximum(np.linalg.norm(factor, axis=2), _LEAST_SIGMA)
    return np.concatenate([np.log(sigmas), (factor / sigmas[:, :, None])[:, *LOWER]], axis=1)


def _held(out: ColumnWriter, values: Array, bounds: Array, steps: Array) -> Array:
    """Writes rows of values (n, c); returns them as they will be read."""
    changed, numbers = np.empty(len(values), bool), np.empty(values.shape, np.int64)
    kernels.hold(values, bounds, steps, changed, numbers)
    at = np.flatnonzero(changed)
    out.add(np.array([len(at)]))
    out.add(np.diff(at))
    for column in numbers[at].T:
        out.add(np.diff(column, prepend=0))
    return numbers * steps


def _differences(stamps_ns: Ints) -> Ints:
    """The first as it is, then how each interval differs from the one before it."""
    return np.diff(np.diff(stamps_ns, prepend=0), prepend=0)


def runs(keyframe: Ints) -> tuple[Ints, Ints]:
    """Where scans begin to be told by another keyframe (r,), and which of these runs each scan is in (n,)."""
    begins = np.diff(keyframe, prepend=NO_KEYFRAME) != 0
    return np.flatnonzero(begins), np.cumsum(begins) - 1
