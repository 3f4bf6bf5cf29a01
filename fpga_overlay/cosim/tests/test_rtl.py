"""The driver, PYNQ's DMA driver and the cores' RTL in one: to the bit what the golden model gives."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from fpga_overlay.cosim.device import CosimDevice, GoldenLogic, VerilatedLogic
from fpga_overlay.driver import Accelerator, AcceleratorError
from fpga_overlay.driver.self_test import made_knots, made_scan
from fpga_overlay.driver.tests.conftest import LIMITS, assert_same, parts
from splitslam.scan import Scan
from tests.deskew.motions import FAST_TURN_RADPS, far_points, imu_offsets, turning

RINGS, COLUMNS = 16, 1800


class CutShort(VerilatedLogic):
    """The cores, and a DMA that may be stopped in the middle of a packet."""

    beats: int | None = None

    def answer(self, beats: np.ndarray) -> list[np.ndarray]:
        beats, self.beats = beats[: self.beats], None
        return super().answer(beats)


@pytest.fixture(scope="module")
def logic() -> CutShort:
    return CutShort(RINGS, COLUMNS)


@pytest.fixture(scope="module")
def by_rtl(logic: CutShort) -> Iterator[Accelerator]:
    accelerator = Accelerator.on_device(CosimDevice(logic), RINGS, COLUMNS, LIMITS)
    yield accelerator
    accelerator.close()


@pytest.fixture(scope="module")
def by_model() -> Iterator[Accelerator]:
    accelerator = Accelerator.on_device(CosimDevice(GoldenLogic()), RINGS, COLUMNS, LIMITS)
    yield accelerator
    accelerator.close()


def scan_of(count: int, seed: int, range_m: float) -> Scan:
    points, time = far_points(count, range_m, seed)
    ring = np.random.default_rng(seed).integers(0, RINGS + 1, count).astype(np.uint8)
    return Scan(0, 100_000_000, points, np.sort(time), ring, np.zeros(count, np.uint8))


@pytest.mark.parametrize(("count", "range_m"), [(0, 1.0), (1, 5.0), (2, 0.0), (777, 511.0), (28_800, 60.0)])
def test_scans_of_all_lengths_are_to_the_bit_the_model_s(by_rtl, by_model, count: int, range_m: float) -> None:
    for rate_hz in (100, 4000):
        knots = turning(imu_offsets(rate_hz), FAST_TURN_RADPS)
        scan = scan_of(count, count, range_m)
        assert_same(parts(by_rtl.run(scan, knots)), parts(by_model.run(scan, knots)))


def test_a_packet_cut_short_is_answered_with_an_error_and_the_next_scan_is_right(by_rtl, by_model, logic) -> None:
    scan, knots = made_scan(RINGS), made_knots()
    right = parts(by_model.run(scan, knots))
    for beats in (1, 2, 5, 1000):
        logic.beats = beats
        with pytest.raises(AcceleratorError) as error:
            by_rtl.run(scan, knots)
        assert error.value.reason == "answer"
        assert_same(parts(by_rtl.run(scan, knots)), right)
