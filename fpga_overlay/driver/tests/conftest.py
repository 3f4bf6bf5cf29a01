"""PYNQ's device interface with the golden model, or what a test puts there, behind the DMA."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from edge_agent.features.integer import Limits
from fpga_overlay.driver import AcceleratedImage, Accelerator

LIMITS = Limits(occlusion=307, corner=1024, flat=324, sectors=6)


@pytest.fixture
def opened() -> Iterator[Callable[..., tuple[Accelerator, Any]]]:
    """open(rings, columns, logic, **options) -> the accelerator and its device; closed at the end."""
    from fpga_overlay.cosim.device import CosimDevice, GoldenLogic

    made: list[Accelerator] = []

    def opening(rings: int = 16, columns: int = 1800, logic: Any = None, **options: Any) -> tuple[Accelerator, Any]:
        device = CosimDevice(logic or GoldenLogic())
        made.append(Accelerator.on_device(device, rings, columns, LIMITS, **options))
        return made[-1], device

    yield opening
    for accelerator in made:
        accelerator.close()


def parts(image: AcceleratedImage) -> dict[str, np.ndarray]:
    """Copies of all that an image holds, by name."""
    names = ("points_lidar", "ring", "column", "source", "ring_start")
    found = {name: getattr(image, name).copy() for name in names}
    found |= {name: getattr(image.marks, name).copy() for name in ("d", "marks", "sector")}
    return found | {"counts": np.array([image.duplicates, image.outside, image.invalid])}


def assert_same(a: dict[str, np.ndarray], b: dict[str, np.ndarray]) -> None:
    """To the bit."""
    for name in a:
        np.testing.assert_array_equal(a[name], b[name], err_msg=name)
