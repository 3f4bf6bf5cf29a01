"""The compiled transforms against splitslam.se3."""

from __future__ import annotations

import numpy as np
import pytest

from splitslam import _se3_kernels as kernels
from splitslam import se3


@pytest.mark.parametrize("angle_rad", [0.0, 1e-9, 1e-5, 1e-3, 0.5, 3.1])
def test_compiled_transforms_equal_their_twins(angle_rad: float):
    rng = np.random.default_rng(3)
    for _ in range(20):
        axis = rng.normal(size=3)
        xi = np.concatenate([angle_rad * axis / np.linalg.norm(axis), rng.normal(0, 10, 3)])
        A, B = se3.exp(xi), se3.exp(rng.normal(size=6))
        out, tangent, ad = np.empty((4, 4)), np.empty(6), np.empty((6, 6))
        kernels.exp(xi, out)
        np.testing.assert_allclose(out, A, atol=1e-12)
        kernels.log(A, tangent)
        np.testing.assert_allclose(tangent, se3.log(A), atol=1e-9)
        kernels.multiply(A, B, out)
        np.testing.assert_allclose(out, A @ B, atol=1e-12)
        kernels.inverse(A, out)
        np.testing.assert_allclose(out, se3.inv(A), atol=1e-12)
        kernels.adjoint(A, ad)
        np.testing.assert_allclose(ad, se3.adjoint(A), atol=1e-12)
