"""The clouds that ours is compared with must be coded well, and come back."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import clouds
from tests.features.made_scan import made_scan

HALF_STEP_M = 0.5 * clouds.STEP_M + 1e-4
POINTS = made_scan().points_lidar
THINNED = clouds.thinned(POINTS, 0.4)


def farthest_m(a: np.ndarray, b: np.ndarray) -> float:
    """The largest distance along an axis from a point of `a` to the nearest of `b`."""
    from scipy.spatial import KDTree

    return float(KDTree(b).query(a, p=np.inf)[0].max())


@pytest.mark.parametrize(
    "codec", [(clouds.encode_morton, clouds.decode_morton), (clouds.encode_draco, clouds.decode_draco)]
)
def test_a_cloud_comes_back_to_half_a_centimetre_an_axis(codec):
    encode, decode = codec
    back = decode(encode(THINNED))
    assert back.shape == THINNED.shape
    assert farthest_m(back, THINNED) < HALF_STEP_M
    assert farthest_m(THINNED, back) < HALF_STEP_M


def test_both_need_what_is_known_of_them():
    """About 25 bits a point of a decimated VLP-16 cloud, Morton order or Draco; this room is smaller than a yard."""
    for encode in (clouds.encode_morton, clouds.encode_draco):
        assert 12 < 8 * len(encode(THINNED)) / len(THINNED) < 27


def test_morton_order_is_worth_its_sort(monkeypatch: pytest.MonkeyPatch):
    shuffled = np.random.default_rng(1).permutation(THINNED)
    ordered = len(clouds.encode_morton(shuffled))
    monkeypatch.setattr(clouds, "_morton", lambda steps: np.zeros(len(steps), np.uint64))
    assert ordered < 0.85 * len(clouds.encode_morton(shuffled))


def test_a_morton_code_interleaves_the_bits_of_the_axes():
    steps = np.random.default_rng(2).integers(-(1 << 20), 1 << 20, (20, 3)).astype(np.int32)
    bits = [[f"{int(value) + (1 << 20):021b}" for value in row] for row in steps]
    naive = [int("".join(z + y + x for x, y, z in zip(*row, strict=True)), 2) for row in bits]
    assert clouds._morton(steps).tolist() == naive


def test_thinning_keeps_one_centroid_a_voxel():
    points = np.array([[0.1, 0.1, 0.1], [0.3, 0.1, 0.1], [-0.1, 0.1, 0.1]], np.float32)
    assert np.allclose(clouds.thinned(points, 0.5), [[-0.1, 0.1, 0.1], [0.2, 0.1, 0.1]])
    cells = np.unique(np.floor(POINTS / 0.4), axis=0)
    assert len(THINNED) == len(cells)
