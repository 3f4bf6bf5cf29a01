"""`python -m tests.monitoring.sick_logic run --config FILE`: the real agent on a board whose logic never answers."""

from __future__ import annotations

from typing import Any, cast

from edge_agent import __main__ as agent
from edge_agent.deskew import fpga
from edge_agent.image_node import CpuImageNode
from edge_agent.settings import PipelineSettings
from fpga_overlay.driver import AcceleratorError


class DeafLogic:
    """Takes every scan and lets the driver wait."""

    def run(self, *_: Any) -> Any:
        raise AcceleratorError("timeout", "told to")

    def close(self) -> None:
        pass


def _open(settings: PipelineSettings, spare: CpuImageNode, rings: int, columns: int) -> fpga.AcceleratedImageNode:
    return fpga.AcceleratedImageNode("fpga", cast(Any, DeafLogic()), spare)


if __name__ == "__main__":
    fpga.open_accelerated = _open
    agent.main()
