"""The figures' own arithmetic and workloads; the figures themselves come from `make fpga-report`."""

from __future__ import annotations

import numpy as np
import pytest

from fpga_overlay.golden import features, packet
from fpga_overlay.report import __main__ as command
from fpga_overlay.report import cores, workload
from fpga_overlay.report.board import Zcu104
from fpga_overlay.report.host import HostCost, host_cost
from fpga_overlay.report.prediction import put_together

COUNTS = {"dsp", "bram36", "uram", "lut", "ff"}


def beats(count: int) -> np.ndarray:
    return np.arange(4 * count, dtype=np.uint32).reshape(count, 4)


def golden(asked: cores.Request) -> np.ndarray:
    return features.answer(asked.header, asked.table.words, asked.points)


def trailer(answer: np.ndarray) -> tuple[int, int, int, int]:
    """Points, invalid ones, records, duplicates."""
    return int(answer[-2, 1]), int(answer[-2, 2]), int(answer[-1, 0]), int(answer[-1, 1])


def test_a_full_scan_has_one_point_in_every_cell() -> None:
    assert trailer(golden(cores.full_request(16, 1800))) == (28800, 0, 28800, 0)
    assert trailer(golden(cores.full_request(64, 2048))) == (131072, 0, 131072, 0)


def test_a_random_image_has_gaps_doubles_and_points_that_are_none() -> None:
    scan = workload.random_image(64, 1024, 1)
    assert np.isnan(scan.points_lidar).any(axis=1).sum() > 100
    assert np.isinf(scan.points_lidar).any(axis=1).sum() > 100
    assert np.count_nonzero(scan.ring == 64) > 100
    asked = cores.request(scan, workload.turning(), 64, 1024)
    points, invalid, records, duplicates = trailer(golden(asked))
    assert min(invalid, duplicates) > 500
    assert 0.2 * 64 * 1024 < records < 0.9 * 64 * 1024
    marks = golden(asked)[packet.HEADER_BEATS + points : -packet.TRAILER_BEATS].reshape(-1).view(
        np.uint64
    ) >> np.uint64(61)
    assert all(np.count_nonzero(marks & np.uint64(bit)) > 100 for bit in (1, 2, 4))


def test_the_motion_turns_at_the_paper_s_fastest() -> None:
    knots = workload.turning(500.0, np.pi / 2)
    step = np.linalg.norm(np.diff(knots.rotation, axis=0), axis=1) / (np.diff(knots.offsets_ns) * 1e-9)
    assert np.degrees(step.max()) == pytest.approx(217, rel=0.02)


def test_answers_differ_by_the_beats_that_are_wrong_missing_or_too_many() -> None:
    wrong = beats(9)
    wrong[4, 2] += 1
    assert cores.differing(beats(9), beats(9)) == 0
    assert cores.differing(wrong, beats(9)) == 1
    assert cores.differing(beats(7), wrong) == 3
    assert cores.differing(beats(12), beats(9)) == 3


def test_the_prediction_adds_up_what_follows_each_other() -> None:
    board = Zcu104()
    host = HostCost(
        write=0.05, exchange=0.01, marks=0.02, total=0.12, registers=20, sent=beats(4000), received=beats(8000)
    )
    made = put_together(board, host, clocks=50_000 - board.start_clocks)
    assert made.parts_ms["resample_and_pack"] == pytest.approx(0.4)
    assert made.parts_ms["flush"] == pytest.approx(1000 * 40e-6)
    assert made.parts_ms["invalidate"] == pytest.approx(2000 * 40e-6)
    assert made.parts_ms["dma_set_up"] == pytest.approx(0.08 + 0.004)
    assert made.parts_ms["transfer"] == pytest.approx(0.5)
    assert made.parts_ms["unpack"] == pytest.approx(0.32)
    assert made.total_ms == pytest.approx(0.4 + 0.04 + 0.08 + 0.084 + 0.5 + 0.05 + 0.32)
    assert made.marks_ms == pytest.approx(0.16)
    assert made.processor_share == pytest.approx(1 - 0.5 / made.total_ms)


@pytest.mark.parametrize("with_features", [True, False])
def test_the_driver_s_cost_is_that_of_whole_runs_of_it(with_features: bool) -> None:
    scan, knots = workload.full_scan(16, 256), workload.turning()
    asked = cores.request(scan, knots, 16, 256, 0 if with_features else packet.BYPASS_FEATURES)
    cost = host_cost(scan, knots, golden(asked), 16, 256, features=with_features)
    assert 0 < cost.write < cost.total
    assert 0 < cost.exchange < cost.total
    assert cost.read > 0
    assert (cost.marks > 0) is not with_features
    assert cost.registers > 8
    assert len(cost.sent) >= len(asked.beats)
    assert len(cost.received) >= len(golden(asked))


def test_the_report_has_the_keys_that_were_promised(monkeypatch: pytest.MonkeyPatch) -> None:
    host = HostCost(0.05, 0.01, 0.0, 0.1, 20, beats(4), beats(4))
    monkeypatch.setattr(cores, "deskew_core", lambda: None)
    monkeypatch.setattr(cores, "both_cores", lambda: None)
    monkeypatch.setattr(cores, "full_request", lambda *_: None)
    monkeypatch.setattr(cores, "cycles", lambda *_: 30_000)
    monkeypatch.setattr(cores, "max_error_mm", lambda *_: 0.1)
    monkeypatch.setattr(cores, "mismatches", lambda *_: 0)
    counts = {name: dict.fromkeys(COUNTS, 1) for name in ("deskew", "features", "total")}
    monkeypatch.setattr(command, "resources", lambda: counts)
    monkeypatch.setattr(command, "predict", lambda *_, **__: put_together(Zcu104(), host, 40_000))
    made = command.report()
    assert set(made) == {"deskew", "features", "total", "core_ms", "end_to_end_ms", "end_to_end"}
    assert set(made["deskew"]) == {"cycles_28800", "cycles_64x2048", "cycles_128x2048", "max_error_mm", *COUNTS}
    assert set(made["features"]) == {"cycles_28800", "mismatched_points", *COUNTS}
    assert set(made["total"]) == COUNTS
    assert made["core_ms"] == pytest.approx(0.3)
    assert made["end_to_end_ms"] == pytest.approx(made["end_to_end"]["features_in_logic"]["total_ms"])
