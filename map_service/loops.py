"""Loop closures: candidates by radius and time, verification as a stateless job for a process pool."""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import small_gicp
from numpy.typing import NDArray

from map_service.settings import LoopSettings

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class LoopJob:
    """Two clouds (N, 3) float32 in the frames of their keyframes, and T_older_newer (4, 4) as the graph sees it."""

    older: int
    newer: int
    target_older: NDArray[np.float32]
    source_newer: NDArray[np.float32]
    T_older_newer: Array
    settings: LoopSettings


@dataclass(frozen=True, slots=True, eq=False)
class LoopResult:
    """How the verification went; `reason` is empty when the loop is accepted."""

    older: int
    newer: int
    T_older_newer: Array
    accepted: bool
    reason: str
    inlier_share: float
    rms_m: float


class LoopVerifier(Protocol):
    """Runs `verify` somewhere else and hands the result over later."""

    def submit(self, job: LoopJob) -> Future[LoopResult]:
        """Queues a job; the future's result is a LoopResult."""
        ...


def verify(job: LoopJob) -> LoopResult:
    """GICP from the graph's guess, coarse then fine; accepted when nearly all of the newer cloud lies on the older."""
    s = job.settings
    T = job.T_older_newer
    target, source = job.target_older.astype(np.float64), job.source_newer.astype(np.float64)
    result = None
    for distance_m, voxel_m in ((s.coarse_distance_m, 0.5), (s.fine_distance_m, 0.25)):
        result = small_gicp.align(
            target,
            source,
            T,
            registration_type="GICP",
            downsampling_resolution=voxel_m,
            max_correspondence_distance=distance_m,
            max_iterations=40,
        )
        T = result.T_target_source
    assert result is not None
    tree = small_gicp.KdTree(target)
    moved = source @ T[:3, :3].T + T[:3, 3]
    _, squares = tree.batch_nearest_neighbor_search(moved)
    squares = np.asarray(squares).reshape(-1)
    near = squares < s.inlier_m**2
    share, rms = float(near.mean()), float(np.sqrt(squares[near].mean())) if near.any() else float("inf")
    shift = float(np.linalg.norm(T[:3, 3] - job.T_older_newer[:3, 3]))
    reason = ""
    if not result.converged:
        reason = "not_converged"
    elif share < s.min_inlier_share:
        reason = "few_inliers"
    elif shift > s.max_shift_m:
        reason = "too_far"
    return LoopResult(job.older, job.newer, T, not reason, reason, share, rms)


def candidate(
    positions_m: Array, stamps_ns: NDArray[np.int64], newest: int, last_used: int, settings: LoopSettings
) -> int | None:
    """The nearest keyframe to `newest` inside the radius and older than the time gap; None: no candidate.

    positions_m: (n, 3); last_used: newest keyframe that a candidate was already made for, -1: none.
    """
    s = settings
    if last_used >= 0 and np.linalg.norm(positions_m[newest] - positions_m[last_used]) < s.spacing_m:
        return None
    old = stamps_ns[newest] - stamps_ns[: newest + 1] > s.min_age_s * 1e9
    distance = np.linalg.norm(positions_m[: newest + 1] - positions_m[newest], axis=1)
    distance[~old] = np.inf
    best = int(np.argmin(distance))
    return best if distance[best] < s.radius_m else None
