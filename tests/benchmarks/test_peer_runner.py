"""The peers' side, as far as it goes without the peers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks import dump, peer_runner, peers
from splitslam.errors import InputError

DURATION_NS = 99_000_000


def points(rings: int, per_ring: int, seed: int = 1) -> np.ndarray:
    rng = np.random.default_rng(seed)
    out = np.zeros(rings * per_ring, dump.POINT)
    out["row"] = np.repeat(np.arange(rings), per_ring)
    out["t"] = rng.integers(0, DURATION_NS, len(out))
    out["x"] = rng.uniform(1.0, 50.0, len(out))
    return rng.permutation(out)


def test_both_sides_agree_on_what_a_point_is():
    assert dump.POINT == peer_runner.POINT


@pytest.mark.parametrize("per_ring", [1, 700, 1000, 1100])
def test_the_grid_keeps_every_point_with_its_own_time_in_order_of_time(per_ring: int):
    cloud = points(4, per_ring)
    grid = peer_runner.in_grid(cloud, 4, 1000, DURATION_NS)
    assert grid.shape == (4, max(1000, per_ring))
    there = grid["x"] > 0
    assert np.array_equal(np.sort(grid[there], order=("x", "t")), np.sort(cloud, order=("x", "t")))
    for ring in range(4):
        assert (np.diff(grid["t"][ring][there[ring]].astype(np.int64)) >= 0).all()
        assert (grid["row"][ring] == ring).all()


def test_an_empty_cell_has_the_time_of_its_column():
    cloud = points(2, 600)
    grid = peer_runner.in_grid(cloud, 2, 1000, DURATION_NS)
    empty = grid["x"][0] == 0
    column_ns = np.arange(1000)[empty] * DURATION_NS / 999
    np.testing.assert_allclose(grid["t"][0][empty], column_ns, atol=1)
    assert grid["t"][:, -1].min() > 0.9 * DURATION_NS


def test_columns_move_only_where_two_points_want_the_same():
    wanted = np.array([0, 3, 3, 3, 9, 9])
    assert peer_runner.distinct(wanted, 10).tolist() == [0, 3, 4, 5, 8, 9]
    assert peer_runner.distinct(np.array([1, 4, 8]), 10).tolist() == [1, 4, 8]


def test_a_scan_comes_after_the_sample_that_covers_it_or_before(tmp_path: Path):
    samples = np.zeros(10, dump.SAMPLE)
    samples["stamp_ns"] = np.arange(10) * 10
    scans = np.zeros(2, dump.SCAN)
    scans["end_ns"] = [35, 60]
    np.save(tmp_path / "imu.npy", samples)
    np.save(tmp_path / "scans.npy", scans)

    def fed(covered: bool) -> list[list[int]]:
        return [part["stamp_ns"].tolist() for part, _ in peer_runner.steps(tmp_path, covered)]

    assert fed(True) == [[0, 10, 20, 30, 40], [50, 60]]
    assert fed(False) == [[0, 10, 20, 30], [40, 50]]


def test_a_peer_that_dies_has_no_trajectory_and_its_last_words_are_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    script = tmp_path / "python"
    script.write_text("#!/bin/sh\necho starting\necho 'Segmentation fault' >&2\nexit 139\n")
    script.chmod(0o755)
    monkeypatch.setattr(peers, "PYTHON", script)
    run = peers.run_peer("dlio", tmp_path, tmp_path)
    assert run.trajectory is None
    assert run.ended == "exit code 139: Segmentation fault"


def test_without_the_peers_there_is_one_line_that_says_how_to_get_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(peers, "PYTHON", tmp_path / "nothing")
    with pytest.raises(InputError, match=r"make bench-setup"):
        peers.check_peers_installed()
