"""The service's compiled kernels on disk: filled when an image is built or a wheel installed."""

from __future__ import annotations

from map_service.block_warm_up import warm_up_blocks
from map_service.engine import SlamEngine
from map_service.settings import PipelineSettings
from splitslam.compile_count import KernelReport, counted


def fill() -> KernelReport:
    """Runs every kernel of the service once."""
    engine = SlamEngine(PipelineSettings(), 1)
    try:
        with counted() as report:
            engine.warm_up()
            warm_up_blocks()
    finally:
        engine.close()
    return report
