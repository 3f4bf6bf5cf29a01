"""The driver over PYNQ's own DMA driver and device interface, the golden model in the cores' place."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from edge_agent.deskew.reference import deskew_float64
from edge_agent.features.integer import FeatureMarks
from edge_agent.features.projection import Projector
from fpga_overlay.cosim.device import HANDOFF, CosimDevice, GoldenLogic
from fpga_overlay.cosim.dma_registers import LENGTH, RECEIVE, STATUS
from fpga_overlay.driver import Accelerator, AcceleratorError
from fpga_overlay.driver.self_test import made_knots, made_scan
from fpga_overlay.driver.tests.conftest import LIMITS, assert_same, parts
from fpga_overlay.golden import fixed
from splitslam.errors import InputError
from splitslam.scan import Scan
from tests.deskew.motions import FAST_TURN_RADPS, far_points, imu_offsets, turning
from tests.tolerances import DESKEW_FPGA_M

KNOTS = turning(imu_offsets(200), FAST_TURN_RADPS)


def scan_of(count: int, seed: int = 0, range_m: float = 30.0) -> Scan:
    points, time = far_points(count, range_m, seed)
    ring = np.random.default_rng(seed).integers(0, 16, count).astype(np.uint8)
    return Scan(0, 100_000_000, points, np.sort(time), ring, np.zeros(count, np.uint8))


def test_the_image_is_the_cpu_s_with_points_deskewed(opened) -> None:
    accelerator, _ = opened()
    scan = scan_of(20_000)
    image = accelerator.run(scan, KNOTS)
    seen = Projector(16, 1800).project(scan)
    cells, expected = (set(zip(i.ring.tolist(), i.column.tolist(), strict=True)) for i in (image, seen))
    assert len(cells ^ expected) <= 20  # a point within 0.06 mm of a column's edge
    assert len(cells) > 10_000
    assert abs(image.duplicates - seen.duplicates) <= 20
    exact = deskew_float64(scan.points_lidar[image.source].astype(np.float64), scan.t_offset_ns[image.source], KNOTS)
    assert np.linalg.norm(image.points_lidar - exact, axis=1).max() <= DESKEW_FPGA_M
    np.testing.assert_array_equal(image.ring, scan.ring[image.source])
    assert np.all(np.diff(image.ring.astype(np.int64) * 2048 + image.column) > 0)


def test_marks_are_those_of_the_shared_kernels(opened) -> None:
    accelerator, _ = opened()
    image = accelerator.run(made_scan(16), made_knots())
    raw = made_scan(16).points_lidar[image.source]
    range_q = fixed.range_of(*(fixed.from_float32(raw[:, c])[0] for c in range(3)))
    expected = FeatureMarks.of(range_q.astype(np.int32), image.column, image.ring_start, LIMITS)
    for name in ("d", "marks", "sector"):
        np.testing.assert_array_equal(getattr(image.marks, name), getattr(expected, name))
    assert set(image.marks.marks) == {0, 1, 2, 4}
    assert (image.duplicates, image.outside, image.invalid) == (1, 1, 3)


def test_with_the_second_core_bypassed_this_processor_makes_the_same_image(opened) -> None:
    whole, alone = opened()[0], opened(features=False)[0]
    for scan in (made_scan(16), scan_of(20_000)):
        assert_same(parts(whole.run(scan, KNOTS)), parts(alone.run(scan, KNOTS)))


@pytest.mark.parametrize(("rings", "columns"), [(1, 2), (16, 1800), (64, 2048), (128, 2048)])
def test_every_size_of_image_opens_and_passes_its_self_test(opened, rings: int, columns: int) -> None:
    accelerator, _ = opened(rings, columns)
    image = accelerator.run(made_scan(rings), KNOTS)
    assert image.ring.max(initial=0) < rings
    assert image.column.max(initial=0) < columns
    assert len(image.ring_start) == rings + 1


def test_a_scan_without_points_and_one_without_usable_points_are_empty_images(opened) -> None:
    accelerator, _ = opened()
    empty = accelerator.run(scan_of(0), KNOTS)
    assert len(empty) == 0
    assert not empty.ring_start.any()
    hopeless = replace(scan_of(50), points_lidar=np.full((50, 3), np.nan, np.float32))
    image = accelerator.run(hopeless, KNOTS)
    assert (len(image), image.invalid) == (0, 50)


def test_scans_of_all_lengths_follow_each_other_and_buffers_grow(opened) -> None:
    accelerator, device = opened()
    before = len(device.memory)
    for count in (5, 40_000, 7, 60_000, 1):
        image = accelerator.run(scan_of(count, count), KNOTS)
        assert len(image) + image.duplicates == count
    assert len(device.memory) == before + 4  # two buffers, twice


def test_the_receiving_side_is_started_first(opened) -> None:
    accelerator, device = opened()
    device.dma.log.clear()
    accelerator.run(made_scan(16), KNOTS)
    lengths = [offset for offset, _ in device.dma.log if offset % RECEIVE == LENGTH]
    assert lengths == [RECEIVE + LENGTH, LENGTH]


def test_a_sending_side_that_is_done_after_the_answer_is_waited_for(opened, monkeypatch: pytest.MonkeyPatch) -> None:
    accelerator, device = opened(timeout_s=5.0)
    finish, read = device.dma.send.finish, device.dma.read
    late: list[int] = []
    polls: list[int] = []

    def read_late(offset: int) -> int:
        if late and not device.dma.receive.busy:
            polls.append(offset)
            if polls.count(STATUS) > 5:
                finish(late.pop())
                polls.clear()
        return read(offset)

    monkeypatch.setattr(device.dma.send, "finish", late.append)
    monkeypatch.setattr(device.dma, "read", read_late)
    for _ in range(3):
        assert len(accelerator.run(made_scan(16), KNOTS)) > 0
        assert not late


def test_interrupts_are_awaited_where_they_are_wired(opened) -> None:
    """PYNQ's own wait_async; in the place of the kernel's UIO file something that is set."""
    accelerator, device = opened(timeout_s=5.0)
    dma = accelerator._link._dma
    waits = []

    class Interrupt:
        async def wait(self) -> None:
            waits.append(1)
            await asyncio.sleep(0)
            device.dma.receive.finish(*late)

    late: list[int] = []
    dma.recvchannel._interrupt = dma.s2mm_introut = Interrupt()
    accelerator._link._wired = True
    plain = parts(accelerator.run(made_scan(16), KNOTS))

    finish = device.dma.receive.finish
    device.dma.receive.finish = lambda nbytes: late.append(nbytes) or setattr(device.dma.receive, "finish", finish)
    assert_same(parts(accelerator.run(made_scan(16), KNOTS)), plain)
    assert waits == [1]
    assert device.dma.receive.status & 1 << 12 == 0  # wait_async has cleared it


def test_a_scan_that_no_packet_holds_is_refused_and_the_next_one_works(opened) -> None:
    accelerator, _ = opened()
    with pytest.raises(AcceleratorError, match="262145 points, expected at most 262144") as error:
        accelerator.run(scan_of(2**18 + 1), KNOTS)
    assert error.value.reason == "size"
    assert len(accelerator.run(made_scan(16), KNOTS)) > 0


@pytest.mark.parametrize(
    ("rings", "columns", "limits", "line"),
    [
        (129, 1800, LIMITS, "rings: 129, expected 1 to 128"),
        (16, 4096, LIMITS, "columns: 4096, expected 1 to 2048"),
        (16, 1801, LIMITS, "columns: 1801, expected an even number"),
        (16, 1800, replace(LIMITS, sectors=8), "sectors: 8, expected 1 to 7"),
        (16, 1800, replace(LIMITS, corner=2**22), "corner threshold in 1/1024 m: 4194304, expected 1 to 4194303"),
    ],
)
def test_a_sensor_that_the_logic_cannot_hold_is_refused_before_anything_is_loaded(rings, columns, limits, line) -> None:
    for opening in (Accelerator.open, Accelerator.open_cosim):
        with pytest.raises(InputError) as error:
            opening(rings, columns, limits)
        assert line in str(error.value)
        assert "\n" not in str(error.value)


def test_without_a_board_opening_says_so_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.bit cannot be loaded: ") as error:
        Accelerator.open(16, 1800, LIMITS, tmp_path / "none.bit")
    assert "\n" not in str(error.value)


def test_a_dma_whose_length_register_is_too_short_is_refused(tmp_path: Path) -> None:
    short = tmp_path / "short.hwh"
    short.write_text(HANDOFF.read_text().replace('c_sg_length_width" VALUE="26"', 'c_sg_length_width" VALUE="22"'))
    with pytest.raises(InputError, match=r"holds 4194303 bytes, expected 6291520 \(c_sg_length_width 26\)"):
        Accelerator.on_device(CosimDevice(GoldenLogic(), short), 16, 1800, LIMITS)
