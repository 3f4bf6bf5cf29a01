"""The grid's kernels against naive twins."""

from __future__ import annotations

import numpy as np
import pytest

from splitslam.export.grid._grid_kernels import FULL, HIT, MISS, MOST_GAPS, grow_ground, mark_hits, trace_rays

CELL_M = 0.1
FRAME = np.array([-2.0, -1.0, CELL_M, -0.5, 0.2, 0.6])  # layers from -0.5, 0.2, 0.8 and 1.4 to 2.0 m
SHAPE = (20, 40)
LAYERS = 4


def blank() -> tuple[np.ndarray, np.ndarray]:
    return np.full((2, LAYERS, *SHAPE), -1, np.int32), np.zeros((2, LAYERS, *SHAPE), np.uint16)


def cells_naively(start: np.ndarray, end: np.ndarray, stop: float) -> set[tuple[int, int]]:
    """The cells of a line, by a step of a thousandth of a cell; without those that it only touches at a corner."""
    steps = max(int(stop * np.linalg.norm((end - start)[:2]) / CELL_M * 1000), 1)
    share = (np.arange(steps) + 0.5) / steps * stop
    at = np.floor((start[:2] + share[:, None] * (end - start)[:2] - FRAME[:2]) / CELL_M).astype(int)[:, ::-1]
    passed, count = np.unique(at[((at >= 0) & (at < SHAPE)).all(axis=1)], axis=0, return_counts=True)
    return {(int(i), int(j)) for i, j in passed[count > 1]}


@pytest.mark.parametrize("seed", range(6))
def test_a_ray_passes_the_cells_that_a_line_passes(seed: int) -> None:
    rng = np.random.default_rng(seed)
    sensor = np.array([*rng.uniform(-3.0, 3.0, 2), 0.5])  # outside of the grid, too
    ends = np.column_stack([rng.uniform(-4.0, 4.0, (8, 2)), np.full(8, 0.5)])
    ends[0, 0], ends[1, 1] = sensor[0], sensor[1]  # along the axes
    stops = rng.uniform(0.3, 1.0, 8)
    for end, stop in zip(ends, stops, strict=True):
        marks, counts = blank()
        trace_rays(sensor, (sensor + stop * (end - sensor))[None], FRAME, np.zeros(SHAPE, np.float32), marks, counts, 3)
        found = {(int(i), int(j)) for i, j in np.argwhere(counts[MISS, 1])}
        expected = cells_naively(sensor, end, stop)
        assert len(found ^ expected) <= 1  # where the line only grazes a cell
        assert set(np.unique(marks[MISS])) <= {-1, 3}


def test_only_what_is_between_the_heights_over_the_ground_counts() -> None:
    marks, counts = blank()
    ground = np.zeros(SHAPE, np.float32)
    ground[:, 20:] = 1.5  # a step up half way
    sensor, end = np.array([-1.95, 0.05, 3.01]), np.array([1.95, 0.05, 0.01])
    trace_rays(sensor, end[None], FRAME, ground, marks, counts, 0)
    x = FRAME[0] + (np.arange(SHAPE[1]) + 0.5) * CELL_M
    over = 3.01 - 3.0 * (x + 1.95) / 3.9 - ground[10]
    for layer, (low, high) in enumerate([(-0.5, 0.2), (0.2, 0.8), (0.8, 1.4), (1.4, 2.0)]):
        np.testing.assert_array_equal(counts[MISS, layer, 10] == 1, (over >= low) & (over < high))


def test_a_cell_counts_once_a_view_and_a_hit_is_no_miss() -> None:
    marks, counts = blank()
    ground = np.zeros(SHAPE, np.float32)
    sensor, end = np.array([-1.95, 0.05, 0.5]), np.array([1.55, 0.05, 0.5])
    hit = np.array([[0.05, 0.05, 0.5], [0.06, 0.04, 0.7], [50.0, 0.0, 0.0]])
    for view in range(3):
        mark_hits(hit, FRAME, marks, counts, view)
        trace_rays(sensor, np.array([end, end, end]), FRAME, ground, marks, counts, view)
    assert counts[HIT, 1, 10, 20] == 3
    assert counts[HIT].sum() == 3
    assert counts[MISS, 1, 10, 20] == 0
    assert set(counts[MISS, 1, 10, :20].tolist()) == {3}


def test_counts_stay_at_their_largest() -> None:
    marks, counts = blank()
    counts[:] = FULL
    point = np.array([[0.05, 0.05, 0.5]])
    mark_hits(point, FRAME, marks, counts, 1)
    trace_rays(np.array([-1.0, 0.05, 0.5]), point, FRAME, np.zeros(SHAPE, np.float32), marks, counts, 2)
    assert (counts == FULL).all()


def grown_naively(lowest: np.ndarray, ground: np.ndarray, step_m: float) -> np.ndarray:
    """Breadth first, in the kernel's order."""
    ground, front = ground.copy(), [tuple(cell) for cell in np.argwhere(~np.isnan(ground))]
    gaps = dict.fromkeys(front, 0)
    while front:
        r, c = front.pop(0)
        for i, j in ((r + 1, c), (r - 1, c), (r, c + 1), (r, c - 1)):
            if 0 <= i < ground.shape[0] and 0 <= j < ground.shape[1] and np.isnan(ground[i, j]):
                gap, low = min(gaps[r, c] + 1, MOST_GAPS), lowest[i, j]
                near = abs(low - ground[r, c]) <= step_m * gap
                ground[i, j], gaps[i, j] = (low, 0) if near else (ground[r, c], gap)
                front.append((i, j))
    return ground


def test_the_ground_grows_over_slopes_and_not_up_walls() -> None:
    rng = np.random.default_rng(1)
    lowest = 0.2 * np.arange(15.0) * np.ones((12, 1)) + rng.normal(0, 0.02, (12, 15))  # uphill
    lowest[3:6, 4:9] += 3.0  # a house
    lowest[rng.random(lowest.shape) < 0.3] = np.inf  # nothing seen
    ground = np.full(lowest.shape, np.nan)
    ground[0, :2] = 0.0
    expected = grown_naively(lowest, ground, 0.35)
    queue = np.zeros((ground.size, 2), np.int64)
    queue[:2] = np.argwhere(~np.isnan(ground))
    grow_ground(lowest, ground, np.zeros(ground.shape, np.int16), queue, 2, 0.35)
    np.testing.assert_array_equal(ground, expected)
    assert ground[3:6, 4:9].max() < 2.5
    assert ground[:, -1].mean() > 2.0
