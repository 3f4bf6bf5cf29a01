"""Times in turns: what a ratio is held against, and when a bar is met."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from benchmarks import dump, peer_runner, speed_figures
from benchmarks.speed_figures import OurCost, Spread, Turn


def report(edge: float, map_: float) -> dict[str, Any]:
    times = {"mean": 1.0, "std": 0.1, "p50": 1.0, "p99": 2.0, "max": 3.0}
    return {
        "cpu_ms_per_scan": {"edge": edge, "map": map_, "reader": 50.0},
        "edge_ms": dict.fromkeys(("motion", "deskew", "features", "encode", "total"), times),
        "map_ms": dict.fromkeys(("registration", "graph", "total"), times),
    }


def cost(edge: float, map_: float) -> OurCost:
    return OurCost.of(report(edge, map_))


def test_a_peer_is_held_against_the_runs_before_and_after_it_without_the_reader():
    turn = Turn("lio_sam", 90.0, 5.0, cost(4.0, 6.0), cost(8.0, 12.0))
    assert turn.ratio == pytest.approx(90.0 / 15.0)


def test_a_machine_that_slows_down_by_half_between_turns_leaves_the_ratio():
    fast, slow = cost(4.0, 6.0), cost(6.0, 9.0)
    turns = [Turn("dlio", 30.0, 1.0, fast, fast), Turn("dlio", 45.0, 1.0, slow, slow)]
    ratio = speed_figures.compared(turns)["dlio"]["ratio"]
    assert ratio == pytest.approx({"median": 3.0, "min": 3.0, "max": 3.0})


@pytest.mark.parametrize(("peer", "bar"), [("lio_sam", 7.0), ("dlio", 2.5)])
def test_a_bar_is_met_by_the_median_and_missed_just_below_it(peer: str, bar: float):
    ours = cost(4.0, 6.0)
    for factor, met in ((1.001, True), (0.999, False)):
        turns = [Turn(peer, 10.0 * bar * f, 1.0, ours, ours) for f in (0.5, factor, 2.0)]
        assert speed_figures.compared(turns)[peer]["met"] is met
        assert ("**no**" in speed_figures.peers_table(turns)) is not met


def test_a_peer_without_a_bar_has_no_verdict():
    found = speed_figures.compared([Turn("rko_lio", 8.0, 1.0, cost(4.0, 6.0), cost(4.0, 6.0))])
    assert found["rko_lio"]["met"] is None


def test_what_no_stage_did_is_the_process_without_its_stages():
    found = speed_figures.ours_dict([cost(4.0, 6.0), cost(5.0, 7.0), cost(9.0, 9.0)])
    assert found["outside_ms"]["edge"] == {"median": 4.0, "min": 3.0, "max": 8.0}
    assert found["cpu_ms"]["both"] == {"median": 12.0, "min": 10.0, "max": 18.0}
    assert str(Spread.of([1.0, 3.0, 2.0])) == "2.00 (1.00 to 3.00)"


def test_every_figure_of_the_edge_is_predicted_for_an_a53_and_none_of_the_map_s():
    table = speed_figures.ours_table([cost(4.0, 6.0)])
    cells = {
        row[0].strip("*"): row for row in ([c.strip() for c in line.split("|")[1:-1]] for line in table.split("\n"))
    }
    assert cells["SplitSLAM"][-1] == "A53: predicted, not measured"
    assert cells["edge: process"][-1] == "32.0"
    edge = [row for name, row in cells.items() if name.startswith(("edge", "reader"))]
    assert len(edge) == 8
    assert all(float(row[-1]) >= 0.0 for row in edge)
    assert {row[-1] for name, row in cells.items() if name.startswith(("map", "both"))} == {"-"}


class CountingPeer:
    """Spends much in making its input and nothing in its own calls."""

    covered = False

    def __init__(self, sensors: dict[str, Any]) -> None:
        self.seen: list[int] = []

    def sample(self, stamp_ns: int, gyro_radps: object, accel_mps2: object) -> int:
        return stamp_ns

    def cloud(self, stamp_ns: int, end_ns: int, points: np.ndarray) -> int:
        values = np.random.default_rng(1).normal(size=200_000)
        for _ in range(5):
            values = np.sort(values[::-1])
        return stamp_ns

    def imu(self, sample: int) -> None:
        self.seen.append(sample)

    def scan(self, cloud: int) -> int:
        self.seen.append(cloud)
        return cloud

    def poses(self, found: int) -> list[tuple[int, np.ndarray]]:
        return [(found, np.eye(4))]


def test_a_peers_time_is_that_of_its_own_calls(tmp_path, monkeypatch: pytest.MonkeyPatch):
    scans, samples = np.zeros(3, dump.SCAN), np.zeros(6, dump.SAMPLE)
    scans["stamp_ns"], scans["end_ns"], scans["end"] = [1, 21, 41], [20, 40, 60], 1
    samples["stamp_ns"] = np.arange(6) * 10
    np.save(tmp_path / "scans.npy", scans)
    np.save(tmp_path / "imu.npy", samples)
    np.zeros(1, dump.POINT).tofile(tmp_path / "points.bin")
    (tmp_path / "sensors.json").write_text("{}")
    monkeypatch.setitem(peer_runner.PEERS, "dlio", CountingPeer)
    monkeypatch.setattr("sys.argv", ["peer_runner.py", "dlio", str(tmp_path), str(tmp_path / "dlio.npz")])
    peer_runner.main()
    with np.load(tmp_path / "dlio.npz") as made:
        assert made["stamps_ns"].tolist() == [1, 21, 41]
        assert made["prepare_s"].min() > 10 * made["cpu_s"].max()
