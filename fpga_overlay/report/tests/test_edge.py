"""The edge with the cores: the same frames as in software, and no time of the simulation in the processor's share."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from edge_agent.settings import PipelineSettings
from fpga_overlay.cosim.verilated import VerilatedTop
from fpga_overlay.report import edge
from fpga_overlay.report.board import Zcu104
from splitslam.bench.in_one_process import Seen, run_both

SCANS = 6


@pytest.fixture(scope="module")
def run(shared_data: Path) -> tuple[edge.EdgeRun, list[bytes], list[bytes], float]:
    """A run with the cores, its frames, those of one in software, and the CPU time that was simulated, ms."""
    drive = shared_data / "yard1/yard1.bag", shared_data / "yard1/yard1.yaml"
    with_cores, in_software = list[bytes](), list[bytes]()
    made = edge.EdgeRun(Zcu104(), VerilatedTop(16, 2048))

    def noting(seen: Seen):
        with_cores.append(seen.frame.payload)
        return made.wire(seen)

    def plain(seen: Seen):
        in_software.append(seen.frame.payload)
        return seen.decoded()

    run_both(*drive, wire=noting, image_node=made.image_node, max_scans=SCANS)
    run_both(*drive, wire=plain, edge_settings=PipelineSettings(deskew="cpu"), max_scans=SCANS)
    return made, with_cores, in_software, made._link.simulated_ms


def test_every_frame_is_that_of_the_software_to_the_byte(run):
    _, with_cores, in_software, _ = run
    assert len(with_cores) == SCANS
    assert with_cores == in_software


def test_a_scan_takes_a_clock_a_point_and_a_clock_a_cell_and_little_more(run):
    for row in run[0].rows[1:]:
        least = row["points"] + 16 * 1800
        assert least < row["clocks"] < 1.1 * least
        assert row["cores_ms"] == pytest.approx(row["clocks"] * 1e-5, rel=0.01)


def test_the_simulations_time_is_in_no_stage(run):
    made, _, _, simulated_ms = run
    deskew_ms = sum(row["ps_cpu_ms"]["deskew"] for row in made.rows[1:])
    assert 0 < deskew_ms < 0.5 * simulated_ms
    for row in made.rows:
        stages = [ms for stage, ms in row["ps_cpu_ms"].items() if stage != "total"]
        assert row["ps_cpu_ms"]["total"] >= 0.95 * sum(stages)


def test_on_the_board_the_image_takes_the_predicted_processor_and_the_cores(run):
    board = Zcu104()
    for row in run[0].rows:
        least = board.processor_ms(row["ps_cpu_ms"]["deskew"]) + row["cores_ms"]
        assert least < row["image_on_board_ms"] < least + 2.0
    assert np.isfinite([row["image_on_board_ms"] for row in run[0].rows]).all()
