"""Kernel of the descent: all iterations of a registration in one call, so that nothing but itself is in the caches.

A class of features is a tuple: slots, moments, geometry and rules of its voxels (_kernels.py), its points (N, 3) as
they came and as they are deskewed again, their times (N,) in s, what they are matched with (N, 16). Frame `lidar`.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from splitslam.registration._equation_kernels import advance, deskew_again, equations, exceeds, spurious_of_both
from splitslam.registration._kernels import FASTMATH, match

_ORIGINAL, _SHIFTED, _OFFSETS, _FITS = range(4, 8)  # of a class

# `rules`, what all scans share: the settings of the same names
(
    MAX_ITERATIONS,
    DAMPING,
    GATE_END_M,
    POINT_SIGMA_M,
    ROBUST_SIGMAS,
    CORRELATION,
    CONVERGED_M,
    CONVERGED_RAD,
    DEGENERATE_INFORMATION,
    DEGENERATE_RATIO,
    REMATCH_M,
    LEVER_M,
) = range(12)

# `state` of one descent: how far from the map a point may lie, m; by how much the pose has moved since the points were
# matched, m; iterations so far; are the points deskewed again, have they been; does a step wait for its equations; and
# how the last equations came about, as `linearise` says it
GATE_M, UNMATCHED_M, ITERATIONS, AGAIN, SHIFTED, WAITING, MATCHED, INLIERS, SQUARES = range(9)
STATE = 9

CONVERGED, EXHAUSTED, UNOBSERVED = range(3)  # how a call ends


@njit(cache=True, nogil=True, fastmath=FASTMATH, inline="always")
def trust(inliers, squares, correlation):
    """Neighbouring residuals are correlated (same plane, same laser): features count for less than they are.

    squares: of the residuals of so many inliers, summed, in sigmas.
    """
    error = math.sqrt(squares / max(inliers, 1.0))
    return 1.0 / (correlation * max(error * error, 0.25))


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def _points(features, state):
    """(N, 3) of a class as they are now."""
    return features[_SHIFTED] if state[SHIFTED] != 0.0 else features[_ORIGINAL]


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def _linearise(corners, surfs, T, normal, rules, state):
    """The next equations at T (4, 4), of points that are matched again when the pose has moved by `rematch_m`."""
    H, b, spurious, _ = normal
    on_corners, on_surfs = _points(corners, state), _points(surfs, state)
    if state[UNMATCHED_M] > rules[REMATCH_M]:
        gate_m = state[GATE_M]
        match(corners[0], corners[1], corners[2], corners[3], on_corners, T, gate_m, corners[_FITS])
        match(surfs[0], surfs[1], surfs[2], surfs[3], on_surfs, T, gate_m, surfs[_FITS])
        state[UNMATCHED_M] = 0.0
    noise = np.array([rules[POINT_SIGMA_M], rules[ROBUST_SIGMAS], state[GATE_M]])
    matched = (corners[_FITS], on_corners), (surfs[_FITS], on_surfs)
    state[MATCHED], state[INLIERS], state[SQUARES] = equations(matched[0], matched[1], T, noise, H, b)
    if state[ITERATIONS] == 1.0:  # it hardly changes with the pose
        spurious_of_both(matched[0], matched[1], T, noise, spurious)


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def _observed(normal, scale, rules, state):
    """Is no eigenvalue below either threshold? Two factorisations instead of a decomposition."""
    H, _, spurious, metres = normal
    least = rules[DEGENERATE_INFORMATION] / trust(state[INLIERS], state[SQUARES], rules[CORRELATION])
    return exceeds(H, metres, least, scale) and exceeds(H, spurious, rules[DEGENERATE_RATIO], scale)


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def descend(corners, surfs, poses, prior, normal, tangents, gains, plan):
    """Levenberg-Marquardt from the prediction, until it has CONVERGED or is EXHAUSTED.

    UNOBSERVED: the caller takes directions out of H and b, if there are any, and calls again.
    poses: T (4, 4), which is moved, and the prediction's inverse. prior (6, 6): the prediction's information. normal:
    H (6, 6), b (6,), spurious information (6, 6), and that of a metre in each direction (6, 6). tangents (3, 6), gains
    (2, 6): see `advance`; gains[1] is the scale of the axes. plan: `rules` and `state`.
    """
    T, T_back = poses
    rules, state = plan
    while True:
        if state[WAITING] == 0.0:
            if state[ITERATIONS] == rules[MAX_ITERATIONS]:
                return EXHAUSTED
            state[ITERATIONS] += 1.0
            _linearise(corners, surfs, T, normal, rules, state)
            if not _observed(normal, gains[1], rules, state):
                state[WAITING] = 1.0
                return UNOBSERVED
        state[WAITING] = 0.0
        H, b = normal[0], normal[1]
        turned_rad, moved_m, twisted_mps = advance(H, prior, b, T, T_back, tangents, gains, rules[DAMPING])
        if state[AGAIN] != 0.0:
            moved_m += 0.1 * twisted_mps
            deskew_again(corners[_ORIGINAL], corners[_OFFSETS], tangents[1], corners[_SHIFTED])
            deskew_again(surfs[_ORIGINAL], surfs[_OFFSETS], tangents[1], surfs[_SHIFTED])
            state[SHIFTED] = 1.0
        if moved_m < rules[CONVERGED_M] and turned_rad < rules[CONVERGED_RAD]:
            return CONVERGED
        state[UNMATCHED_M] += moved_m + rules[LEVER_M] * turned_rad
        state[GATE_M] = max(rules[GATE_END_M], 0.6 * state[GATE_M])
