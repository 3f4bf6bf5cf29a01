"""Where two clouds lie to each other when nothing is known but which way is up: KISS-Matcher (Lim et al., ICRA 2025).

The package has wheels for x86_64 only. Elsewhere nothing is found here, and a candidate starts from the heading of
its place descriptor.
"""

from __future__ import annotations

import os
from functools import cache
from typing import Any

import numpy as np
import small_gicp
from numpy.typing import NDArray

from splitslam import se3

Array = NDArray[np.float64]
_NEIGHBOURS = 6
_MIN_POINTS = 200
_MIN_MATCHES = 10


def search(
    target: NDArray[np.float32],
    source: NDArray[np.float32],
    up_target: Array,
    up_source: Array,
    voxel_m: float,
) -> Array | None:
    """T_target_source (4, 4) by point features alone, or None; clouds (N, 3), (M, 3); up_*: (3,) against gravity.

    The same clouds give the same bytes. Rotation is sought about the vertical only (Quatro): a match that would tip
    the robot over cannot be found.
    """
    library = _library()
    if library is None or min(_describable(target, voxel_m), _describable(source, voxel_m)) < _MIN_POINTS:
        return None
    R_target, R_source = se3.level_rotation(up_target), se3.level_rotation(up_source)
    matcher = library.KISSMatcher(library.KISSMatcherConfig(voxel_size=voxel_m, use_quatro=True))
    matched = matcher.match(
        np.asfortranarray((source @ R_source.T).T, np.float64), np.asfortranarray((target @ R_target.T).T, np.float64)
    )
    if len(matched[0]) < _MIN_MATCHES:
        return None
    solution = matcher.prune_and_solve(*matched)
    if not solution.valid:
        return None
    T = se3.compose(np.asarray(solution.rotation, np.float64), np.asarray(solution.translation, np.float64).reshape(3))
    level_target = se3.compose(R_target, np.zeros(3))
    return se3.orthonormalised(se3.inv(level_target) @ T @ se3.compose(R_source, np.zeros(3)))


def _describable(points: NDArray[np.float32], voxel_m: float) -> int:
    """How many thinned points have the neighbours that a normal needs: the library crashes where none has."""
    thinned = small_gicp.voxelgrid_sampling(np.asarray(points, np.float64), voxel_m).points()[:, :3]
    if len(thinned) < _NEIGHBOURS:
        return 0
    _, squares = small_gicp.KdTree(thinned).batch_knn_search(thinned, _NEIGHBOURS)
    return int((np.asarray(squares).reshape(len(thinned), -1).max(axis=1) < (3 * voxel_m) ** 2).sum())


@cache
def _library() -> Any:
    """The package, run on one thread: its result depends on the order in which threads finish.

    It offers no such setting, but the threads it takes (TBB) are as many as the cores this process may use when they
    are first asked for.
    """
    try:
        import kiss_matcher
    except ImportError:
        return None
    library: Any = kiss_matcher  # it has no types
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(cores)})
    try:
        made = np.asfortranarray(np.random.default_rng(0).uniform(-2.0, 2.0, (300, 3)).T)
        library.KISSMatcher(library.KISSMatcherConfig(voxel_size=0.5)).match(made, made)
    finally:
        os.sched_setaffinity(0, cores)
    return library
