from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from benchmarks import accuracy, tables
from benchmarks.cells import Limits, Store
from benchmarks.command import listed
from benchmarks.drives import CLEAN, DRIVES, FAULTS, Case
from benchmarks.peers import PEERS
from splitslam.errors import InputError


def cell(ate_m: float | None, *, diverged: bool = False, missing: int = 0, **more: Any) -> dict[str, Any]:
    errors = {"ate_m": ate_m, "rpe_1s_m": ate_m, "max_m": ate_m, "diverged": diverged, "missing": missing}
    failed = ate_m is None or diverged or missing > 10
    return {"score": {**errors, "scans": 100, "offset_ns": 52_000_000, "failed": failed}, "ended": "", **more}


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store(tmp_path / "cells")


SEEDS = [Case(DRIVES["park"], FAULTS, seed) for seed in (1, 2, 3)]
CASES = {SEEDS[0]: SEEDS}


def row(table: str) -> list[str]:
    return [field.strip() for field in table.splitlines()[2].strip("|").split("|")]


def fill(store: Store, ours: list[dict[str, Any]], peers: dict[str, dict[str, Any]]) -> None:
    for case, one in zip(SEEDS, ours, strict=True):
        store.put(case, "ours", one)
    for name, one in peers.items():
        store.put(SEEDS[0], name, one)


def test_our_column_is_the_median_of_the_seeds_and_their_worst(store: Store):
    fill(store, [cell(0.02), cell(0.01), cell(0.0345)], {"dlio": cell(0.021)})
    assert row(tables.comparison(store, CASES, "ours")) == [
        *("park", "all faults", "2.00 (3.45)", "-", "2.10", "-", "-", "yes")
    ]


def test_being_behind_the_best_peer_is_said(store: Store):
    fill(store, [cell(0.02)] * 3, {"dlio": cell(0.021), "kiss_icp": cell(0.0199)})
    assert row(tables.comparison(store, CASES, "ours"))[-1] == "**no**"


def test_a_peer_that_failed_is_not_the_best_however_small_its_figure(store: Store):
    peers = {"dlio": cell(0.001, missing=60), "kiss_icp": cell(0.002, diverged=True), "lio_sam": cell(None)}
    fill(store, [cell(0.02)] * 3, peers)
    assert row(tables.comparison(store, CASES, "ours"))[3:] == [
        *("no poses", "0.10 (poses missing)", "diverged (0.20)", "-", "yes")
    ]


def test_a_run_of_ours_that_failed_is_the_worst_and_two_of_three_are_the_median(store: Store):
    fill(store, [cell(0.02), cell(5.0, diverged=True), cell(0.01)], {"dlio": cell(0.5)})
    assert row(tables.comparison(store, CASES, "ours"))[2] == "2.00 (failed)"
    fill(store, [cell(None), cell(5.0, diverged=True), cell(0.01)], {"dlio": cell(0.5)})
    assert row(tables.comparison(store, CASES, "ours"))[2::5] == ["failed (failed)", "**no**"]


def test_the_sweep_names_divergence_and_what_the_answers_said(store: Store):
    case = Case(DRIVES["campus"], "extrinsic=2")
    jumps = {"odom_max_m": 0.004, "odom_max_deg": 0.1}
    nees = {"mean": 1.5}
    states = {"tracking": 0.8, "degenerate": 0.2}
    store.put(case, "ours", cell(9.0, diverged=True, jumps=jumps, nees=nees, states=states))
    assert row(tables.sweep(store, [case]))[-3:] == ["1.50", "degenerate 20%", "**yes**"]


def test_cells_that_are_there_are_not_computed_again(store: Store, monkeypatch: pytest.MonkeyPatch):
    computed: list[tuple[str, list[str]]] = []

    def compute(case, systems, store, limits, say) -> None:
        computed.append((case.name, list(systems)))
        for system in systems:
            store.put(case, system, cell(0.1))

    monkeypatch.setattr(accuracy, "compute", compute)
    store.put(SEEDS[0], "dlio", cell(0.1))
    plan = accuracy._plan(["odometry"], ["ours", *PEERS], CASES, named=True)
    accuracy._compute(plan, store, Limits(), jobs=1)
    assert computed == [
        ("park.middle.1", ["ours_odometry", "lio_sam", "kiss_icp", "rko_lio"]),
        ("park.middle.2", ["ours_odometry"]),
        ("park.middle.3", ["ours_odometry"]),
    ]
    computed.clear()
    accuracy._compute(plan, store, Limits(), jobs=2)
    assert computed == []


def test_recordings_are_run_once_and_made_drives_with_every_seed_clean_and_with_faults():
    cases = accuracy._comparison_cases(["yard1", "street"], seeds=5)
    assert {first: len(seeds) for first, seeds in cases.items()} == {
        Case(DRIVES["yard1"]): 1,
        Case(DRIVES["street"], CLEAN): 5,
        Case(DRIVES["street"], FAULTS): 5,
    }


def test_what_is_not_known_is_one_line():
    with pytest.raises(InputError, match=r"--drives: expected some of .*, found 'yrad1'"):
        listed("--drives", "yard1,yrad1", tuple(DRIVES))
