"""Small kernels of the registration's end against numpy."""

from __future__ import annotations

import numpy as np

from splitslam.registration import _equation_kernels as equations
from splitslam.registration import _kernels as kernels


def test_the_inverse_of_two_informations_is_numpys():
    rng = np.random.default_rng(2)
    M, N = rng.normal(size=(2, 6, 6))
    H, information, out = M @ M.T, N @ N.T + np.eye(6), np.empty((6, 6))
    assert equations.invert(H, information, out)
    np.testing.assert_allclose(out, np.linalg.inv(H + information), rtol=1e-9)
    assert not equations.invert(-H - 2 * information, information, out)


def test_only_what_was_matched_says_who_saw_it_first():
    corners, surfs = np.zeros((2, kernels.GEOMETRY)), np.zeros((3, kernels.GEOMETRY))
    corners[:, kernels.KEYFRAME], surfs[:, kernels.KEYFRAME] = (4, 5), (6, 7, 8)
    corners[1, kernels.KIND] = surfs[2, kernels.KIND] = 1.0
    first = np.zeros(5, np.int64)
    assert equations.first_seen(corners, surfs, first) == 2
    assert first[:2].tolist() == [5, 8]
