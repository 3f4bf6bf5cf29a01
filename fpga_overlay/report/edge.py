"""The edge's whole pipeline on a recording with the cores behind the driver: `python -m fpga_overlay.report.edge`.

By scan: clocks of the RTL on Verilator, and CPU time of all that stays on the processor, measured here, without the
time of the simulation. What a board would make of them is `report.board`; nothing of it ran on one. Called by
`splitslam bench edge`, in .venv-fpga.
"""

from __future__ import annotations

import json
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

from edge_agent.deskew import make_deskewer
from edge_agent.deskew.fpga import AcceleratedImageNode
from edge_agent.features.integer import Limits
from edge_agent.image_node import CpuImageNode
from edge_agent.settings import FeatureSettings
from fpga_overlay.cosim.verilated import VerilatedTop
from fpga_overlay.driver.accelerator import Accelerator, check_fits
from fpga_overlay.driver.dma import DmaLink
from fpga_overlay.golden.packet import Beats
from fpga_overlay.report import cores
from fpga_overlay.report.board import Zcu104
from fpga_overlay.report.host import HostCost, IdleLink
from fpga_overlay.report.prediction import EndToEnd, put_together
from splitslam.bench.in_one_process import Seen, run_both
from splitslam.errors import InputError
from splitslam.features import FeatureFrame


class CoresLink(IdleLink):
    """The driver's link with the verilated cores at its other end, and memory that pauses as the board's does.

    clocks: of the last packet. simulated_ms: CPU time of this thread that the simulation has taken, in all.
    """

    def __init__(self, top: VerilatedTop, pauses: float) -> None:
        super().__init__(1)
        self._top, self._pauses = top, pauses
        self.clocks, self.simulated_ms = 0, 0.0

    def exchange(self, send_beats: int, receive_beats: int) -> Beats:
        """See DmaLink."""
        DmaLink.exchange(self, send_beats, receive_beats)
        begun_ns = time.thread_time_ns()
        made, self.clocks = self._top.run(self.request[:send_beats], idle=self._pauses, stall=self._pauses)
        answer = self._answer[: len(made)]
        answer[:] = made
        self.simulated_ms += (time.thread_time_ns() - begun_ns) * 1e-6
        return answer


class EdgeRun:
    """Sees every scan between edge and map. rows: of the JSON, one a scan. fallbacks: scans that the cores refused."""

    def __init__(self, board: Zcu104, top: VerilatedTop) -> None:
        """top: both cores, of any size that holds the sensor."""
        self.rows: list[dict[str, Any]] = []
        self.fallbacks: Counter[str] = Counter()
        self._board = board
        self._link = CoresLink(top, 1.0 - board.stream_share)
        self._simulated_ms = 0.0

    def image_node(self, rings: int, columns: int) -> AcceleratedImageNode:
        """See splitslam.bench.in_one_process. InputError for a sensor that the logic cannot hold."""
        limits = Limits.of(FeatureSettings())
        check_fits(rings, columns, limits)
        spare = CpuImageNode(make_deskewer("cpu"), rings, columns, limits)
        node = AcceleratedImageNode("cosim", Accelerator(self._link, rings, columns, limits), spare)
        self.fallbacks = node.counts
        return node

    def wire(self, seen: Seen) -> FeatureFrame:
        """One scan more."""
        link, ms = self._link, dict(seen.frame.stage_cpu_ms)
        simulated_ms, self._simulated_ms = link.simulated_ms - self._simulated_ms, link.simulated_ms
        for stage in ("deskew", "total"):
            ms[stage] -= simulated_ms
        image = self._image(ms["deskew"])
        link.mmio.accesses.clear()
        self.rows.append(
            {
                "points": len(seen.scan),
                "clocks": link.clocks,
                "cores_ms": image.parts_ms["transfer"],
                "ps_cpu_ms": ms,
                "image_on_board_ms": image.total_ms,
            }
        )
        return seen.decoded()

    def _image(self, cpu_ms: float) -> EndToEnd:
        """The Image node on the board: all of the driver's time here is in one part."""
        link = self._link
        host = HostCost(
            write=cpu_ms,
            exchange=0.0,
            marks=0.0,
            total=cpu_ms,
            registers=link.mmio.accesses.total(),
            sent=link.request,
            received=link.answer,
        )
        return put_together(self._board, host, link.clocks)


def measure(recording: Path, robot: Path, max_scans: int | None) -> dict[str, Any]:
    """All scans. InputError for what cannot be read, held or built."""
    board = Zcu104()
    run = EdgeRun(board, cores.both_cores())
    run_both(recording, robot, wire=run.wire, image_node=run.image_node, max_scans=max_scans)
    return {
        "label": "clocks of the RTL and CPU time here; never run on a board",
        "board": board.as_json(),
        "fallbacks": sum(count for name, count in run.fallbacks.items() if name != "unusable_points"),
        "scans": run.rows,
    }


def main() -> None:
    """RECORDING ROBOT OUT.json [MAX_SCANS]."""
    recording, robot, out = (Path(argument) for argument in sys.argv[1:4])
    try:
        found = measure(recording, robot, int(sys.argv[4]) if len(sys.argv) > 4 else None)
    except InputError as error:
        print(error, file=sys.stderr)
        sys.exit(error.exit_code)
    out.write_text(json.dumps(found, allow_nan=False), encoding="utf-8")


if __name__ == "__main__":
    main()
