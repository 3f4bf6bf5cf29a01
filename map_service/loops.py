"""Loop closures: candidates, and their verification as a stateless job for a process pool.

A process of the pool loads this module and what it needs: for small_gicp and numpy that takes 0.1 s of CPU.
"""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from map_service.loop_fit import CloudPair, Fit, Rival
from map_service.loop_search import search

if TYPE_CHECKING:
    from map_service.settings import LoopSettings

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class LoopJob:
    """Two clouds (N, 3) float32 in the frames of their keyframes, and a guess of T_older_newer (4, 4).

    up_older, up_newer: (3,) against gravity. by_looks: the places look alike; the guess knows the heading at best.
    """

    older: int
    newer: int
    target_older: NDArray[np.float32]
    source_newer: NDArray[np.float32]
    T_older_newer: Array
    up_older: Array
    up_newer: Array
    by_looks: bool
    settings: LoopSettings


@dataclass(frozen=True, slots=True, eq=False)
class LoopResult:
    """How the verification went; `reason` is empty when the clouds fit.

    covariance: (6, 6) of T_older_newer, right tangent, rotation first; large along what the fit does not observe.
    distinct: every direction is observed and nothing else nearby fits as well.
    """

    older: int
    newer: int
    T_older_newer: Array
    covariance: Array
    by_looks: bool
    reason: str
    inlier_share: float
    rms_m: float
    distinct: bool

    @property
    def accepted(self) -> bool:
        """Do the clouds fit? Whether the loop may enter the graph is the gate's to say."""
        return not self.reason


class LoopVerifier(Protocol):
    """Runs `verify` somewhere else and hands the result over later."""

    def submit(self, job: LoopJob) -> Future[LoopResult]:
        """Queues a job; the future's result is a LoopResult."""
        ...


def refused(job: LoopJob, reason: str) -> LoopResult:
    """The result of a job that found nothing."""
    return LoopResult(
        job.older, job.newer, job.T_older_newer, np.eye(6), job.by_looks, reason, 0.0, float("inf"), False
    )


def stand_by() -> None:
    """What a process of the pool is asked first: with this module it has loaded all that `verify` needs."""


def verify(job: LoopJob) -> LoopResult:
    """GICP from the graph's guess, or from what a search without a guess finds; then the fit is judged."""
    s, T = job.settings, job.T_older_newer
    if job.by_looks:
        found = search(job.target_older, job.source_newer, job.up_older, job.up_newer, _search_voxel_m(job))
        T = job.T_older_newer if found is None else found
    pair = CloudPair(job.target_older, job.source_newer, s.fit)
    if pair.empty or (job.by_looks and pair.near_share(T, s.search_inlier_m) < s.search_inlier_share):
        return refused(job, "no_match")
    fit = pair.fit(*pair.align(T))
    reason, distinct = _reason(job, fit), False
    if not reason:
        rival = pair.rival(fit, job.up_older, turned=job.by_looks)
        if rival.share * s.rival_share > 1.0:  # the search had taken the wrong one
            fit, rival = pair.fit(rival.T_target_source, True), Rival(1.0 / rival.share, fit.T_target_source)
            reason = _reason(job, fit)
        distinct = fit.observed and rival.share < s.rival_share
        # what the fit does not observe is left open by its covariance; a wrong one of several fits is not
        reason = reason or ("" if distinct or not fit.observed else "ambiguous")
    sigmas = np.repeat([s.rotation_sigma_rad**2, s.translation_sigma_m**2], 3)
    return LoopResult(
        job.older,
        job.newer,
        fit.T_target_source,
        fit.covariance + np.diag(sigmas),
        job.by_looks,
        reason,
        fit.forward,
        fit.rms_m,
        distinct,
    )


def _search_voxel_m(job: LoopJob) -> float:
    """Finer in rooms than in the open: a share of the median distance that the newer keyframe looks."""
    s = job.settings
    if not len(job.source_newer):
        return s.search_voxel_max_m
    median_m = float(np.median(np.linalg.norm(job.source_newer, axis=1)))
    return float(np.clip(s.search_voxel_share * median_m, s.search_voxel_min_m, s.search_voxel_max_m))


def _reason(job: LoopJob, fit: Fit) -> str:
    s = job.settings
    T = fit.T_target_source
    if not fit.converged:
        return "not_converged"
    if fit.forward < s.min_inlier_share:
        return "few_inliers"
    if fit.backward < s.min_backward_share:
        return "one_sided"
    if np.linalg.norm(np.cross(job.up_older, T[:3, :3] @ job.up_newer)) > s.max_tilt_rad:
        return "tipped"
    return ""


def near_candidate(
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
