from __future__ import annotations

import numpy as np

from map_service import _search_kernels as kernels
from splitslam import se3
from splitslam.registration.local_map import LocalMap
from splitslam.registration.settings import LocalMapSettings
from tests.map_pipeline.naive import closeness, room

ELSEWHERE = se3.exp(np.array([0, 0, 0.6, 1.5, -2.0, 0.0]))


def test_closeness_equals_its_naive_twin():
    rng = np.random.default_rng(0)
    local_map = LocalMap(LocalMapSettings())
    surfs, corners = room(rng, 1500, 0.01)
    local_map.insert(0, np.eye(4), corners.astype(np.float32), surfs.astype(np.float32))
    seen = [points[::40].astype(np.float32) for points in room(rng, 1500, 0.01)]
    poses = np.array([np.eye(4), se3.exp(np.array([0, 0, 0.1, 0.2, 0.1, 0])), ELSEWHERE])
    for points, voxels in ((seen[0], local_map.surfs), (seen[1], local_map.corners)):
        scores, v = np.zeros(3), voxels.settings
        kernels.closeness(voxels.slots, voxels.geometry, points, poses, v.voxel_m, v.levels, 0.5, scores)
        np.testing.assert_allclose(scores, closeness(voxels, points, poses, 0.5), rtol=1e-9)
        assert scores[0] > 1.2 * scores[2] > 0
