"""What a board can do to a scan: each is an error with its reason, and the next scan is right."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from enum import Enum

import numpy as np
import pytest

from edge_agent.deskew import make_deskewer
from edge_agent.deskew.fpga import AcceleratedImageNode
from edge_agent.image_node import CpuImageNode
from fpga_overlay.cosim.device import CosimDevice, GoldenLogic
from fpga_overlay.driver import Accelerator, AcceleratorError
from fpga_overlay.driver.self_test import made_knots, made_scan
from fpga_overlay.driver.tests.conftest import LIMITS, assert_same, parts
from splitslam.errors import InputError

Packets = list[np.ndarray]
SCAN, KNOTS = made_scan(16), made_knots()


def changed(packets: Packets, beat: int, word: int, change: Callable[[int], int]) -> Packets:
    packets[0][beat, word] = change(int(packets[0][beat, word])) % 2**32
    return packets


class Fault(Enum):
    """(reason, what becomes of the packets that the logic gives)."""

    NEVER = "timeout", lambda p: []
    MAGIC = "answer", lambda p: changed(p, -2, 0, lambda w: w ^ 1 << 20)
    VERSION = "answer", lambda p: changed(p, -2, 0, lambda w: w ^ 1 << 8)
    STATUS = "answer", lambda p: changed(p, -2, 0, lambda w: w | 1)
    HEADER = "answer", lambda p: changed(p, 1, 1, lambda w: w + 1)
    SEQUENCE = "answer", lambda p: changed(p, -2, 3, lambda w: w + 1)
    FROM_THE_FUTURE = "answer", lambda p: changed(changed(p, 0, 3, lambda w: w + 1), -2, 3, lambda w: w + 1)
    COUNT = "answer", lambda p: changed(p, -2, 1, lambda w: w - 1)
    INVALID = "answer", lambda p: changed(p, -2, 2, lambda w: w + 1)
    RECORDS = "answer", lambda p: changed(p, -1, 0, lambda w: w - 2)
    ANY_RECORDS = "answer", lambda p: changed(p, -1, 0, lambda w: 2**31)
    SHORT = "answer", lambda p: [p[0][:-2]]
    TINY = "answer", lambda p: [p[0][:3]]
    HALF = "answer", lambda p: [np.concatenate([p[0][:100], p[0][-2:]])]
    LONG = "dma", lambda p: [np.concatenate([p[0], p[0]])]
    BAD_RECORD = "answer", lambda p: changed(p, -3, 0, lambda w: w ^ 0x3FFFF)
    BAD_CELL = "answer", lambda p: changed(p, 2 + len(SCAN), 0, lambda w: w ^ 1 << 20)


class FaultyLogic(GoldenLogic):
    """The golden model, with the next answer spoilt."""

    def __init__(self) -> None:
        self.spoil: Callable[[Packets], Packets] | None = None
        self.resets = 0

    def answer(self, beats: np.ndarray) -> Packets:
        spoil, self.spoil = self.spoil, None
        packets = super().answer(beats)
        return packets if spoil is None else spoil(packets)

    def reset(self) -> None:
        self.resets += 1


@pytest.mark.parametrize("fault", Fault)
def test_a_fault_is_an_error_with_its_reason_and_the_next_scan_is_right(opened, fault: Fault) -> None:
    logic = FaultyLogic()
    accelerator, _ = opened(logic=logic)
    right, resets = parts(accelerator.run(SCAN, KNOTS)), logic.resets
    reason, logic.spoil = fault.value
    with pytest.raises(AcceleratorError) as error:
        accelerator.run(SCAN, KNOTS)
    assert error.value.reason == reason
    assert "\n" not in str(error.value)
    assert logic.resets == resets + 1
    assert_same(parts(accelerator.run(SCAN, KNOTS)), right)
    assert accelerator.counts == {"resets": 1}


def test_answers_that_came_too_late_are_passed_over(opened) -> None:
    logic = FaultyLogic()
    accelerator, _ = opened(logic=logic)
    late: Packets = []
    logic.spoil = lambda p: late.append(p[0].copy()) or p
    accelerator.run(SCAN, KNOTS)
    logic.spoil = lambda p: late.append(p[0].copy()) or p
    right = parts(accelerator.run(SCAN, KNOTS))
    logic.spoil = lambda p: [*late, *p]
    assert_same(parts(accelerator.run(SCAN, KNOTS)), right)
    assert accelerator.counts == {"stale": 2}


def test_an_answer_left_in_the_logic_by_a_reset_that_did_not_reach_it_is_passed_over(opened) -> None:
    """As where the core's reset is not the DMA's: its answer is still there, and sending waits until it is taken."""
    logic = FaultyLogic()
    accelerator, device = opened(logic=logic)
    right = parts(accelerator.run(SCAN, KNOTS))
    late: Packets = []
    logic.spoil = lambda p: late.extend(p) or []
    with pytest.raises(AcceleratorError, match="timeout: receiving, after 20 ms"):
        accelerator.run(SCAN, KNOTS)
    device.dma._under_way.extend(late)
    assert_same(parts(accelerator.run(SCAN, KNOTS)), right)
    assert accelerator.counts == {"resets": 1, "stale": 1}


def test_a_core_that_swallows_the_next_scan_into_one_that_was_cut_recovers_by_itself(opened) -> None:
    """As where a DMA was reset in the middle of a packet and the core was not: it waits for the packet's end."""

    class Swallowing(GoldenLogic):
        cut = False
        held = np.empty((0, 4), np.uint32)

        def answer(self, beats: np.ndarray) -> Packets:
            whole = np.concatenate([self.held, beats])
            self.held, cut, self.cut = (beats[:500] if self.cut else beats[:0]), self.cut, False
            return [] if cut else super().answer(whole)

    logic = Swallowing()
    accelerator, _ = opened(logic=logic)
    right = parts(accelerator.run(SCAN, KNOTS))
    logic.cut = True
    with pytest.raises(AcceleratorError, match="timeout: receiving"):
        accelerator.run(SCAN, KNOTS)
    with pytest.raises(AcceleratorError, match="dma: receiving: internal error"):  # the answer to both is too long
        accelerator.run(SCAN, KNOTS)
    assert_same(parts(accelerator.run(SCAN, KNOTS)), right)
    assert accelerator.counts == {"resets": 2}


def test_a_stale_answer_alone_is_a_time_out(opened) -> None:
    logic = FaultyLogic()
    accelerator, _ = opened(logic=logic)
    logic.spoil = lambda p: changed(changed(p, 0, 3, lambda w: w - 1), -2, 3, lambda w: w - 1)
    with pytest.raises(AcceleratorError) as error:
        accelerator.run(SCAN, KNOTS)
    assert error.value.reason == "timeout"
    assert accelerator.counts == {"stale": 1, "resets": 1}


def test_the_sequence_wraps(opened) -> None:
    logic = FaultyLogic()
    accelerator, _ = opened(logic=logic)
    accelerator._sequence = 2**32 - 2
    for _ in range(4):
        accelerator.run(SCAN, KNOTS)
    assert accelerator._sequence == 2
    assert not accelerator.counts


def test_memory_that_the_dma_does_not_see_is_an_error_of_the_dma(opened, monkeypatch: pytest.MonkeyPatch) -> None:
    accelerator, device = opened()
    with monkeypatch.context() as patch:
        patch.setattr(device, "window", lambda address, nbytes: None)
        with pytest.raises(AcceleratorError, match="dma: sending: decode error") as error:
            accelerator.run(SCAN, KNOTS)
    assert error.value.reason == "dma"
    assert len(accelerator.run(SCAN, KNOTS)) > 0


def test_a_dma_that_does_not_come_out_of_reset_is_tried_again_at_the_next_scan(opened, monkeypatch) -> None:
    logic = FaultyLogic()
    accelerator, device = opened(logic=logic)
    read = device.dma.read
    logic.spoil = lambda p: []
    with monkeypatch.context() as patch:
        patch.setattr(device.dma, "read", lambda offset: read(offset) | (4 if offset == 0 else 0))
        with pytest.raises(AcceleratorError, match="timeout"):
            accelerator.run(SCAN, KNOTS)
        with pytest.raises(AcceleratorError, match="dma: it does not come out of reset"):
            accelerator.run(SCAN, KNOTS)
    assert len(accelerator.run(SCAN, KNOTS)) > 0


@pytest.mark.parametrize(
    ("spoil", "line"),
    [
        (lambda p: changed(p, 60, 0, lambda w: w ^ 1 << 12), r"1 beats differ, the first is 60: "),
        (lambda p: changed(p, -5, 1, lambda w: w ^ 1 << 7), r"1 beats differ, the first is "),
        (lambda p: [], r"timeout: receiving"),
    ],
)
def test_logic_that_fails_its_self_test_is_refused_with_the_reason(spoil, line: str) -> None:
    logic = FaultyLogic()
    logic.spoil = spoil
    with pytest.raises(InputError, match=line) as error:
        Accelerator.on_device(CosimDevice(logic), 16, 1800, LIMITS)
    assert str(error.value).startswith("deskew fpga: the self-test failed: ")
    assert "\n" not in str(error.value)


def test_the_edge_does_such_a_scan_on_its_processor_counts_it_and_goes_on(opened) -> None:
    logic = FaultyLogic()
    spare = CpuImageNode(make_deskewer("cpu"), 16, 1800, LIMITS)
    node = AcceleratedImageNode("cosim", opened(logic=logic)[0], spare)
    scan = made_scan(16)
    usable = np.isfinite(scan.points_lidar).all(axis=1) & (np.abs(scan.points_lidar).max(axis=1) < 500)
    kept = {name: getattr(scan, name)[usable] for name in ("points_lidar", "t_offset_ns", "ring", "intensity")}
    clean = replace(scan, **kept)
    by_logic = node.image(clean, KNOTS)
    marks = node.marks(by_logic).marks.copy()
    points = by_logic.points_lidar.copy()
    for fault in (Fault.NEVER, Fault.MAGIC, Fault.MAGIC):
        logic.spoil = fault.value[1]
        by_spare = node.image(clean, KNOTS)
        np.testing.assert_array_equal(by_spare.points_lidar, points)  # the cpu does the same, to the bit
        np.testing.assert_array_equal(node.marks(by_spare).marks, marks)
    assert node.counts["timeout"] == 1
    assert node.counts["answer"] == 2
    np.testing.assert_array_equal(node.image(clean, KNOTS).points_lidar, points)
