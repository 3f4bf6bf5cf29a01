"""All iterations of a registration in one kernel, against the same step by step in numpy."""

from __future__ import annotations

import numpy as np
import pytest

from splitslam import se3
from splitslam.registration import _descent_kernels as descent
from splitslam.registration import _kernels as kernels
from splitslam.registration.local_map import VoxelMap
from splitslam.registration.settings import RegistrationSettings, VoxelSettings
from tests.map_pipeline import naive

SETTINGS = RegistrationSettings()
PRIOR = np.diag(1 / np.repeat([0.1**2, 0.3**2], 3))
T_TRUE = se3.exp(np.array([0.01, -0.02, 0.3, 0.5, 0.2, 1.0]))
T_GUESS = T_TRUE @ se3.exp(np.array([0.01, -0.01, 0.02, 0.06, -0.05, 0.03]))
GATE_M = 0.5


class Descent:
    """The arrays of one, of surfs and corners as they are seen from T_TRUE."""

    def __init__(
        self, surfs: np.ndarray, corners: np.ndarray, every: int, again: bool, max_iterations: int = 20
    ) -> None:
        rng, s = np.random.default_rng(5), SETTINGS
        self.classes = []
        kinds = (corners, kernels.LINE, VoxelSettings(levels=2, min_points=5)), (surfs, kernels.PLANE, VoxelSettings())
        arrays = []
        for points, kind, settings in kinds:
            voxels = VoxelMap(settings, kind)
            voxels.insert(points, 0)
            seen = np.ascontiguousarray((points[::every] - T_TRUE[:3, 3]) @ T_TRUE[:3, :3])
            times = rng.uniform(0, 0.1, len(seen))
            self.classes.append((voxels, seen, times))
            arrays.append((*voxels.arrays, seen, np.empty_like(seen), times, np.empty((len(seen), kernels.GEOMETRY))))
        self.corners, self.surfs = arrays
        self.T = T_GUESS.copy()
        self.gains = np.stack([np.full(6, 3.0) * again, s.scale])
        self.normal = np.empty((6, 6)), np.empty(6), np.empty((6, 6)), np.diag(s.scale**2)
        self.state = np.zeros(descent.STATE)
        self.state[[descent.GATE_M, descent.UNMATCHED_M, descent.AGAIN]] = GATE_M, np.inf, again
        points = s.point_sigma_m, s.robust_sigmas, s.correlation
        ends = s.converged_m, s.converged_rad, s.degenerate_information, s.degenerate_ratio
        self.rules = np.array([max_iterations, s.damping, s.gate_end_m, *points, *ends, s.rematch_m, s.lever_m])
        self.tangents = np.zeros((3, 6))

    def go_on(self) -> int:
        poses, plan = (self.T, se3.inv(T_GUESS)), (self.rules, self.state)
        return descent.descend(self.corners, self.surfs, poses, PRIOR, self.normal, self.tangents, self.gains, plan)


def of_a_room(again: bool = False, **others: int) -> Descent:
    return Descent(*naive.room(np.random.default_rng(4), 6000, 0.01), 12, again, **others)


@pytest.mark.parametrize("again", [False, True])
def test_the_descent_ends_where_its_steps_one_by_one_do(again: bool):
    made = of_a_room(again)
    assert made.go_on() == descent.CONVERGED
    T, iterations = naive.descent(made.classes, T_GUESS, PRIOR, made.gains, SETTINGS, GATE_M, again)
    np.testing.assert_allclose(made.T, T, atol=1e-6)
    assert made.state[descent.ITERATIONS] == iterations > 2


def test_a_descent_that_has_not_converged_says_so():
    made = of_a_room(max_iterations=2)
    assert made.go_on() == descent.EXHAUSTED
    assert made.state[descent.ITERATIONS] == 2.0


def test_before_a_step_along_what_nothing_observes_the_caller_is_asked():
    rng = np.random.default_rng(6)
    walls = np.column_stack([rng.uniform(-30, 30, 9000), rng.choice([-1.5, 1.5], 9000), rng.uniform(0, 2.5, 9000)])
    made = Descent(walls + rng.normal(0, 0.01, walls.shape), np.zeros((0, 3)), 40, again=False)
    assert made.go_on() == descent.UNOBSERVED
    np.testing.assert_array_equal(made.T, T_GUESS)
    H, b = made.normal[:2]
    H[:], b[:] = 0.0, 0.0  # none is believed: no step, and so no movement
    assert made.go_on() == descent.CONVERGED
    np.testing.assert_allclose(made.T, T_GUESS, atol=1e-12)
    assert made.state[descent.ITERATIONS] == 1.0
