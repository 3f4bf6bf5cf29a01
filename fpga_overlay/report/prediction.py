"""One scan's way on the board, from its motion to an ordered image: what the paper's 7.07 ms count, predicted."""

from __future__ import annotations

from dataclasses import dataclass

from fpga_overlay.cosim.verilated import VerilatedTop
from fpga_overlay.driver.request import Request
from fpga_overlay.report import workload
from fpga_overlay.report.board import MS_PER_NS, Zcu104
from fpga_overlay.report.host import HostCost, host_cost

ON_LOGIC = "transfer"


@dataclass(frozen=True, slots=True)
class EndToEnd:
    """parts_ms: what follows each other in time. here_ms: CPU time of the driver on this machine, and its parts.

    marks_ms: the Feature node's marks where the logic makes none; not a part, as the paper's figure is without them.
    """

    parts_ms: dict[str, float]
    marks_ms: float
    here_ms: dict[str, float]

    @property
    def total_ms(self) -> float:
        """From the motion's knots to the image."""
        return sum(self.parts_ms.values())

    @property
    def processor_ms(self) -> float:
        """All that the logic does not do: the PS share."""
        return self.total_ms - self.parts_ms[ON_LOGIC]

    @property
    def processor_share(self) -> float:
        """Of the total."""
        return self.processor_ms / self.total_ms

    def as_json(self) -> dict:
        """Rounded to microseconds."""
        return {
            "total_ms": round(self.total_ms, 3),
            "ps_ms": round(self.processor_ms, 3),
            "ps_share": round(self.processor_share, 3),
            "feature_marks_ms": round(self.marks_ms, 3),
            "parts_ms": {name: round(ms, 3) for name, ms in self.parts_ms.items()},
            "cpu_ms_here": {name: round(ms, 4) for name, ms in self.here_ms.items()},
        }


def predict(board: Zcu104, cores: VerilatedTop, asked: Request, *, features: bool) -> EndToEnd:
    """asked: the packet of the 16 x 1800 scan of `workload`, with features in the logic or without."""
    cores.run(asked.beats)  # right after reset the image is still being cleared
    pauses = 1 - board.stream_share
    answer, clocks = cores.run(asked.beats, idle=pauses, stall=pauses)
    scan, knots = workload.full_scan(16, 1800), workload.turning()
    return put_together(board, host_cost(scan, knots, answer, 16, 1800, features=features), clocks)


def put_together(board: Zcu104, host: HostCost, clocks: int) -> EndToEnd:
    """clocks: of the cores with the memory's pauses, from the packet's first beat to the answer's last."""
    parts = {
        "resample_and_pack": board.processor_ms(host.write),
        "flush": board.cache_ms(host.sent),
        "dma_set_up": board.processor_ms(host.exchange) + host.registers * board.register_ns * MS_PER_NS,
        ON_LOGIC: board.clocks_ms(clocks + board.start_clocks),  # both ways, the cores' work inside
        "wait": board.wake_us * 1e-3,
        "invalidate": board.cache_ms(host.received),
        "unpack": board.processor_ms(host.read),
    }
    here = {"write": host.write, "exchange": host.exchange, "marks": host.marks, "read": host.read}
    return EndToEnd(parts, board.processor_ms(host.marks), here)
