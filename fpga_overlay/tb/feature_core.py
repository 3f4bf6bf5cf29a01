"""cocotb: the feature core, bit for bit against the golden model."""

from __future__ import annotations

import itertools
import os
from dataclasses import replace

import cocotb
import numpy as np
import pytest
from cocotb.handle import SimHandleBase

from fpga_overlay.golden import deskew, features, packet
from fpga_overlay.golden.deskew import DeskewedPoints
from fpga_overlay.golden.packet import Beats, Header
from fpga_overlay.tb import images
from fpga_overlay.tb.compare import Exchange, check, go_on
from fpga_overlay.tb.stream import IDLE_PATTERNS, Stream

RINGS, COLUMNS = int(os.environ["DUT_RINGS"]), int(os.environ["DUT_COLUMNS"])
FULL = Header(RINGS, COLUMNS)
NOTHING = images.points_of(np.zeros(0), np.zeros(0), np.zeros(0))


def packet_of(header: Header, points: DeskewedPoints) -> Exchange:
    return deskew.answer_of(header, points), features.answer_to(header, points)


@cocotb.test()
@cocotb.parametrize(idle=IDLE_PATTERNS, stall=IDLE_PATTERNS)
async def scans_of_every_size_come_back_as_the_model_says(dut: SimHandleBase, idle: str, stall: str) -> None:
    sizes = [(RINGS, COLUMNS), (RINGS - 1, COLUMNS - 6), (2, COLUMNS // 2 + 1), (1, 13), (1, 1), (RINGS, COLUMNS)]
    orders = itertools.cycle(["columns", "random", "rings"])
    first = 30 * IDLE_PATTERNS.index(idle) + 10 * IDLE_PATTERNS.index(stall)
    packets = []
    for seed, ((rings, columns), order) in enumerate(zip(sizes, orders, strict=False), first):
        header = Header(rings, columns, sequence=seed + 7)
        points = images.scan(header, seed, filled=(1.0, 0.8, 0.5)[seed % 3], repeated=0.2, order=order)
        packets.append(packet_of(header, images.spoilt(points, 0.05, seed)))
    await check(dut, packets, idle, stall)


@cocotb.test()
async def the_first_point_of_a_cell_wins_however_soon_the_next_one_follows(dut: SimHandleBase) -> None:
    packets = []
    for distance in range(1, 9):
        column = np.arange(COLUMNS)
        column[distance :: 2 * distance] = column[: COLUMNS - distance : 2 * distance]  # as so many points before
        packets.append(packet_of(FULL, images.points_of(0 * column, column, 1000 + column)))
        packets.append(packet_of(FULL, images.points_of(0 * column, column ^ 1, 1000 + column)))
    same = images.points_of(np.full(50, RINGS - 1), np.full(50, COLUMNS - 1), 5000 + np.arange(50))
    await check(dut, [*packets, packet_of(FULL, same)])


@cocotb.test()
async def rings_of_few_points_have_no_window(dut: SimHandleBase) -> None:
    packets = []
    for first in range(0, 36, RINGS):
        counts = [min(first + k, COLUMNS) for k in range(RINGS)]
        ring = np.repeat(np.arange(RINGS), counts)
        rng = np.random.default_rng(first)
        columns = [np.sort(rng.choice(COLUMNS, n, replace=False)) for n in counts]
        points = images.points_of(ring, np.concatenate(columns), rng.choice([4000, 4090, 9000], len(ring)))
        packets += [packet_of(replace(FULL, sectors=sectors), points) for sectors in (1, 6, 7)]
    await check(dut, packets)


@cocotb.test()
async def any_number_of_sectors_up_to_seven_divides_a_ring(dut: SimHandleBase) -> None:
    packets = []
    for sectors in range(8):
        header = replace(FULL, sectors=sectors)
        packets.append(packet_of(header, images.scan(header, sectors, filled=0.5 + 0.07 * sectors, order="rings")))
    await check(dut, packets)


@cocotb.test()
async def thresholds_are_compared_exactly(dut: SimHandleBase) -> None:
    """Ranges at, just below and just above every threshold, the largest values among them."""
    rng = np.random.default_rng(1)
    packets = []
    for base, occlusion, corner, flat in [
        (1000, 20, 100, 40),
        (50, 1, 0, 1),
        (200_000, (1 << 18) - 1, (1 << 22) - 1, (1 << 22) - 1),
        (131_000, 131_000, 1_310_000, 1_310_001),
    ]:
        header = replace(FULL, occlusion=occlusion, corner=corner, flat=flat)
        ring, column = (a.ravel() for a in np.mgrid[:RINGS, :COLUMNS])
        fiftieth = base // 50
        steps = [
            0,
            0,
            0,
            1,
            -1,
            occlusion,
            -occlusion,
            occlusion + 1,
            -occlusion - 1,
            fiftieth,
            -fiftieth,
            fiftieth + 1,
        ]
        range_q = np.clip(base + rng.choice(steps, len(ring)), 1, (1 << 18) - 1)
        packets.append(packet_of(header, images.points_of(ring, column, range_q)))
        gap = COLUMNS // 2 - 5  # two neighbours that are 9, 10, 11, 12 columns apart, by ring
        kept = (column < gap) | (column > gap + 7 + ring % 4)
        range_q[column > gap] += 2 * occlusion
        range_q = np.clip(range_q, 1, (1 << 18) - 1)
        packets.append(packet_of(header, images.points_of(ring[kept], column[kept], range_q[kept])))
    smooth = replace(FULL, occlusion=(1 << 18) - 1, corner=24, flat=12)  # nothing is masked: differences decide
    packets.append(packet_of(smooth, images.points_of(ring, column, 2000 + rng.integers(-3, 4, len(ring)))))
    await check(dut, packets)


@cocotb.test()
@cocotb.parametrize(pauses=IDLE_PATTERNS)
async def bypassed_empty_and_bad_packets_leave_no_trace(dut: SimHandleBase, pauses: str) -> None:
    full = images.scan(FULL, 3, filled=1.0)
    thin = images.scan(FULL, 4, filled=0.4)
    bypass = replace(FULL, flags=packet.BYPASS_FEATURES, sequence=9)
    packets = [
        packet_of(FULL, NOTHING),
        packet_of(FULL, full),
        packet_of(bypass, full),
        packet_of(bypass, NOTHING),
        packet_of(FULL, thin),
        refused_by_the_first_core(packet.TRUNCATED, header=np.zeros((2, 4), np.uint32)),
        refused_by_the_first_core(packet.BAD_HEADER, header=replace(FULL, rings=200).beats()),
        packet_of(FULL, thin),
        ill_at_the_end(FULL, full),
        packet_of(FULL, thin),
    ]
    for header in [
        replace(FULL, rings=RINGS + 1),
        replace(FULL, columns=COLUMNS + 1),
        replace(FULL, columns=4095),
        replace(FULL, rings=0),
        replace(FULL, columns=0),
        replace(FULL, sectors=8),
    ]:
        packets += [too_large(header, full), packet_of(replace(header, flags=packet.BYPASS_FEATURES), full)]
    packets += [packet_of(FULL, NOTHING), packet_of(FULL, thin)]
    await check(dut, packets, pauses, pauses, seed=2)


def refused_by_the_first_core(status: int, header: Beats) -> Exchange:
    beats = np.concatenate([header, np.zeros((2, 4), np.uint32)])
    beats[2, 0] = packet.MAGIC << 16 | packet.VERSION << 8 | status
    return beats, beats


def too_large(header: Header, points: DeskewedPoints) -> Exchange:
    sent = deskew.answer_of(header, points)
    back = sent.copy()
    back[-2, 0] |= packet.BAD_GEOMETRY
    return sent, back


def ill_at_the_end(header: Header, points: DeskewedPoints) -> Exchange:
    """Points that are followed by a trailer with an error."""
    sent = deskew.answer_of(header, points)
    sent[-2, 0] |= packet.TRUNCATED
    return sent, sent


@cocotb.test()
async def packets_that_are_too_short_pass_and_do_no_harm(dut: SimHandleBase) -> None:
    sound = packet_of(FULL, images.scan(FULL, 5))
    short = [(beats, beats) for beats in (sound[0][:n].copy() for n in (1, 2, 3))]
    await check(dut, [short[0], sound, short[1], short[0], short[2], sound])


@cocotb.test()
async def points_without_the_valid_flag_or_outside_the_geometry_are_left_out(dut: SimHandleBase) -> None:
    header = Header(RINGS // 2, COLUMNS - 3)
    inside = images.scan(header, 6)
    strays = [(header.rings, 1), (RINGS - 1, 0), (RINGS + 1, 0), (127, 0), (0, header.columns), (0, 4095), (1, COLUMNS)]
    invalid = [(0, column) for column in range(header.columns)]
    ring, column = (
        np.concatenate([a, b])
        for a, b in zip((inside.ring, inside.column), np.transpose(strays + invalid), strict=True)
    )
    range_q = np.concatenate([inside.range_q, np.full(len(strays) + len(invalid), 4096)])
    order = np.random.default_rng(6).permutation(len(ring))
    valid, kept = ((order < n).astype(np.int64) for n in (len(ring) - len(invalid), len(inside.ring)))
    made = images.points_of(ring[order], column[order], range_q[order])
    sent = deskew.answer_of(header, replace(made, flags=valid))
    expected = features.answer_to(header, replace(made, flags=kept))
    expected[: len(sent) - 2] = sent[:-2]  # the points pass as they came
    expected[-2] = sent[-2]
    await check(dut, [(sent, expected), packet_of(FULL, images.scan(FULL, 7, filled=0.3))])


@cocotb.test()
@cocotb.parametrize(share=[0.01, 0.15, 0.4, 0.6, 0.95])
async def a_reset_at_any_time_leaves_an_empty_core(dut: SimHandleBase, share: float) -> None:
    sound = packet_of(FULL, images.scan(FULL, 8, filled=1.0))
    stream = Stream(dut)
    await stream.reset()
    cells = RINGS * COLUMNS
    with pytest.raises(AssertionError, match="hung"):  # that is, not done by then: two packets take 4 clocks a cell
        await stream.run([sound[0], sound[0]], limit=int(cells / 2 + share * 4 * cells))
    await check(dut, [packet_of(FULL, images.scan(FULL, 9, filled=0.3)), sound])


@cocotb.test()
async def a_scan_takes_a_clock_a_point_and_a_clock_a_cell(dut: SimHandleBase) -> None:
    packets = [packet_of(FULL, images.scan(FULL, 10, filled=1.0, repeated=0.0))]
    stream = await check(dut, packets)
    await go_on(stream, packets)  # the first one waited for the wipe after reset
    assert stream.first_in is not None
    clocks = stream.last_out - stream.first_in + 1
    assert clocks <= 2 * RINGS * COLUMNS + 8 * RINGS + 50, clocks
