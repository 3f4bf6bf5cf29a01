"""cocotb: both cores chained, bit for bit against the golden model; sizes are small, packets many and awkward."""

from __future__ import annotations

import os
from dataclasses import replace

import cocotb
import numpy as np
from cocotb.handle import SimHandleBase

from fpga_overlay.golden import features, packet
from fpga_overlay.tb import packets
from fpga_overlay.tb.compare import Exchange, check
from fpga_overlay.tb.packets import Packet
from fpga_overlay.tb.stream import IDLE_PATTERNS, Stream

SIZE = int(os.environ["DUT_RINGS"]), int(os.environ["DUT_COLUMNS"])
CELLS = SIZE[0] * SIZE[1]


def exchange(sent: Packet) -> Exchange:
    return sent.beats(), features.answer(sent.header, sent.table, sent.points)


def refused(beats: packet.Beats, status: int) -> Exchange:
    return beats, packets.refusal(beats, status)


def some(rng: np.random.Generator, points: int, segments: int, size: tuple[int, int] = SIZE, **header: int) -> Exchange:
    return exchange(packets.random_packet(rng, points, segments, size, **header))


@cocotb.test()
@cocotb.parametrize(idle=IDLE_PATTERNS, stall=IDLE_PATTERNS)
async def scans_come_back_deskewed_and_with_their_features(dut: SimHandleBase, idle: str, stall: str) -> None:
    rng = np.random.default_rng(3)
    sizes = [SIZE, (SIZE[0] - 1, SIZE[1] - 6), (2, SIZE[1] // 2), (1, 2)]
    shapes = [
        (2 * CELLS, 9, sizes[0]),
        (CELLS, 3, sizes[1]),
        (90, 0, sizes[2]),
        (3, 1, sizes[3]),
        (CELLS, 40, sizes[0]),
    ]
    await check(dut, [some(rng, *shape) for shape in shapes], idle, stall)


@cocotb.test()
async def the_next_table_leaves_points_in_flight_alone(dut: SimHandleBase) -> None:
    """Also while the first core's points wait for the second one to read its image out."""
    rng = np.random.default_rng(4)
    for points in (1, 2, 5, 30, CELLS // 2):
        await check(dut, [some(rng, points, segments) for segments in (1, 3, 2, 1)])


@cocotb.test()
async def each_core_can_be_bypassed(dut: SimHandleBase) -> None:
    rng = np.random.default_rng(5)
    both = packet.BYPASS_DESKEW | packet.BYPASS_FEATURES
    flags = [0, packet.BYPASS_FEATURES, 0, packet.BYPASS_DESKEW, both, both, packet.BYPASS_DESKEW, 0]
    await check(dut, [some(rng, 150, 3, flags=f) for f in flags], idle="half")


@cocotb.test()
async def packets_without_points_or_segments_are_answered(dut: SimHandleBase) -> None:
    rng = np.random.default_rng(6)
    shapes = [(5, 2), (0, 3), (0, 0), (0, 0), (200, 0), (0, 1), (0, 2), (200, 3)]
    await check(dut, [some(rng, n, s) for n, s in shapes], stall="half")


@cocotb.test()
async def numbers_that_are_none_stay_out_of_the_image(dut: SimHandleBase) -> None:
    rng = np.random.default_rng(7)
    sent = packets.random_packet(rng, CELLS, 3, SIZE)
    xyz = sent.points[:, :3].view(np.float32)
    bad = rng.random(xyz.shape) < 0.1
    xyz[bad] = rng.choice(np.array([np.nan, np.inf, -np.inf, 512, -1e9, 0], np.float32), bad.sum())
    xyz[:9] = 0
    await check(dut, [exchange(sent), some(rng, 100, 1)])


@cocotb.test()
@cocotb.parametrize(pauses=IDLE_PATTERNS)
async def bad_packets_are_refused_and_leave_no_trace(dut: SimHandleBase, pauses: str) -> None:
    rng = np.random.default_rng(8)
    bad = packets.random_packet(rng, 60, 3, SIZE).beats()
    exchanges = []
    for status, beats in [
        (packet.TRUNCATED, bad[:1]),
        (packet.TRUNCATED, bad[:2]),
        (packet.TRUNCATED, bad[:12]),
        (packet.BAD_HEADER, packets.with_header(bad, magic=0x534D)),
        (packet.BAD_HEADER, packets.with_header(bad, version=2, rings=200, columns=4095)),
        (packet.TOO_MANY_SEGMENTS, packets.with_header(bad, segments=257)),
    ]:
        exchanges += [refused(beats, status), some(rng, 80, 2)]
    for change in ({"rings": SIZE[0] + 1}, {"columns": SIZE[1] + 2}, {"rings": 0}, {"columns": 0}, {"sectors": 8}):
        exchanges += [without_records(rng, **change), some(rng, 80, 2)]
    await check(dut, exchanges, pauses, pauses)


def without_records(rng: np.random.Generator, **change: int) -> Exchange:
    sent = packets.random_packet(rng, 50, 2, SIZE)
    sent = replace(sent, header=replace(sent.header, **change))
    answer = sent.answer()
    answer[-2, 0] |= packet.BAD_GEOMETRY
    return sent.beats(), answer


@cocotb.test()
@cocotb.parametrize(beats=[1, 2, 12, 60])
async def a_reset_in_the_middle_leaves_nothing_behind(dut: SimHandleBase, beats: int) -> None:
    rng = np.random.default_rng(9)
    cut, after = packets.random_packet(rng, 2 * CELLS, 5, SIZE), some(rng, 50, 3)
    stream = Stream(dut)
    await check(dut, [after])  # so that the image is empty and takes points
    await stream.feed(cut.beats()[:beats])
    await check(dut, [after, some(rng, CELLS, 2)])


@cocotb.test()
async def a_point_takes_a_clock_and_a_cell_another(dut: SimHandleBase) -> None:
    rng = np.random.default_rng(10)
    sent = some(rng, 2 * CELLS, 8)
    stream = await check(dut, [sent, sent])
    await stream.run([sent[0]])  # not the first one after reset, which waits for the image to be emptied
    assert stream.first_in is not None
    clocks = stream.last_out - stream.first_in + 1
    assert clocks <= len(sent[0]) + CELLS + 8 * SIZE[0] + 120, clocks
