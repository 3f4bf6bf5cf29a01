from __future__ import annotations

import numpy as np
import pytest

from map_service.cloud import STEP_M, decode_cloud, encode_cloud
from splitslam.errors import DataError


def sample() -> bytes:
    rng = np.random.default_rng(1)
    corners = rng.uniform(-90, 90, (300, 3)).astype(np.float32)
    surfs = rng.uniform(-90, 90, (4000, 3)).astype(np.float32)
    shades = rng.integers(0, 256, 4300).astype(np.uint8)
    data = encode_cloud(corners, surfs, shades[:300], shades[300:])
    points, intensity, is_corner = decode_cloud(data)
    assert np.abs(points[is_corner] - corners).max() <= 0.51 * STEP_M
    assert np.abs(points[~is_corner] - surfs).max() <= 0.51 * STEP_M
    assert (intensity == shades).all()
    assert is_corner.sum() == 300
    return data


def test_a_keyframe_cloud_comes_back_within_its_step():
    assert len(sample()) < 4300 * 12


def test_an_empty_cloud_is_a_cloud():
    none, shades = np.zeros((0, 3), np.float32), np.zeros(0, np.uint8)
    points, intensity, is_corner = decode_cloud(encode_cloud(none, none, shades, shades))
    assert len(points) == len(intensity) == len(is_corner) == 0


@pytest.mark.parametrize("cut", [0, 3, 11, 12, 40, -1])
def test_a_cut_cloud_is_refused(cut):
    with pytest.raises(DataError):
        decode_cloud(sample()[:cut])


def test_changed_bytes_are_refused_or_change_the_points_but_never_the_process():
    data, rng = sample(), np.random.default_rng(2)
    refused = 0
    for _ in range(300):
        broken = bytearray(data)
        broken[rng.integers(len(broken))] ^= 1 << rng.integers(8)
        try:
            decode_cloud(bytes(broken))
        except DataError:
            refused += 1
    assert refused > 0
