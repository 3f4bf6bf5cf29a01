"""Map points out of stored keyframes."""

from __future__ import annotations

import numpy as np
import pytest

from map_service.catalog import StoredKeyframe
from map_service.cloud import encode_cloud
from map_service.export import map_pieces
from splitslam import se3
from splitslam.errors import DataError

STEP_M = 0.005  # of the stored clouds


def keyframe(index: int, T_map_lidar: np.ndarray, points: np.ndarray) -> StoredKeyframe:
    nothing, shade = points[:0], np.full(len(points), 7, np.uint8)
    return StoredKeyframe(index, 1_000 * index, T_map_lidar, encode_cloud(nothing, points, shade[:0], shade))


def cloud(seed: int, n: int = 500) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-20, 20, (n, 3)).astype(np.float32)


def thinned_naively(points: np.ndarray, voxel_m: float) -> list[tuple[float, ...]]:
    kept, seen = [], set()
    for point in points:
        cell = tuple(np.floor(point.astype(np.float64) / voxel_m))
        if cell not in seen:
            seen.add(cell)
            kept.append(tuple(point))
    return kept


def test_points_come_out_in_the_frame_map() -> None:
    T, points = se3.exp(np.array([0.1, -0.2, 0.3, 4.0, 5.0, 6.0])), cloud(1)
    (piece,) = map_pieces([keyframe(3, T, points)], 0.0)
    assert piece.keyframe == 3
    np.testing.assert_allclose(piece.points_map[:, :3], points @ T[:3, :3].T + T[:3, 3], atol=STEP_M)
    assert set(piece.points_map[:, 3]) == {7.0}


def test_each_voxel_of_the_whole_map_keeps_its_first_point() -> None:
    frames = [keyframe(i, se3.exp(np.array([0, 0, 0, 0.3 * i, 0, 0])), cloud(i % 2)) for i in range(4)]
    whole = np.concatenate([piece.points_map[:, :3] for piece in map_pieces(frames, 0.0)])
    pieces = list(map_pieces(frames, 2.0))
    thinned = [tuple(point) for piece in pieces for point in piece.points_map[:, :3]]
    # the naive twin sees float32 points: one on a voxel's face may fall to the other side
    assert len(set(thinned) ^ set(thinned_naively(whole, 2.0))) <= 4
    assert [piece.keyframe for piece in pieces] == [0, 1, 2, 3]
    assert len(pieces[2].points_map) < len(pieces[0].points_map)


def test_a_cloud_that_cannot_be_read_is_a_data_error() -> None:
    with pytest.raises(DataError):
        list(map_pieces([StoredKeyframe(0, 0, np.eye(4), b"garbage")], 0.0))
