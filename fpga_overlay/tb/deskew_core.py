"""cocotb: the deskew core, bit for bit against the golden model; each known trap is a test of its own."""

from __future__ import annotations

import os
from typing import Any

import cocotb
import numpy as np

from fpga_overlay.golden import packet
from fpga_overlay.golden.packet import Beats, Header
from fpga_overlay.tb import compare, packets, tolerances
from fpga_overlay.tb.packets import Packet
from fpga_overlay.tb.scan import turning_scan
from fpga_overlay.tb.stream import IDLE_PATTERNS, Stream

SEED = int(os.environ.get("SEED", "7"))


async def check(dut: Any, sent: list[Beats], expected: list[Beats], idle="never", stall="never") -> Stream:
    """Sends packets back to back into a core fresh from reset and compares every beat that comes back."""
    return await compare.check(dut, list(zip(sent, expected, strict=True)), idle, stall)


async def check_sound(dut: Any, sent: list[Packet], idle="never", stall="never") -> Stream:
    return await check(dut, [p.beats() for p in sent], [p.answer() for p in sent], idle, stall)


def one(points: Beats, table: packets.Table | None = None, size=packets.SIZES[0], **header: int) -> Packet:
    table = np.zeros((0, 28), np.int32) if table is None else table
    return Packet(Header(*size, segments=len(table), **header), table, points)


@cocotb.test()
@cocotb.parametrize(idle=IDLE_PATTERNS, stall=IDLE_PATTERNS, size=packets.SIZES)
async def answers_as_the_golden_model(dut, idle, stall, size):
    rng = np.random.default_rng(SEED)
    sent = [random_shape(rng, size) for _ in range(6)]
    await check_sound(dut, sent, idle, stall)


@cocotb.test()
async def packets_of_different_images_do_not_mix(dut):
    """Each packet's rings and columns are its own, though the one before is still on the way."""
    rng = np.random.default_rng(SEED)
    sizes = [packets.SIZES[n % 3] for n in range(9)]
    await check_sound(dut, [packets.random_packet(rng, 15, n % 2, size) for n, size in enumerate(sizes)])


def random_shape(rng: np.random.Generator, size: tuple[int, int]) -> Packet:
    return packets.random_packet(rng, int(rng.integers(0, 70)), int(rng.integers(0, 9)), size)


@cocotb.test()
async def every_27_bit_table_is_followed_to_the_bit(dut):
    rng = np.random.default_rng(SEED)
    table = packets.any_table(rng, packets.breaks(rng, 40, 1 << 22))
    ticks = rng.integers(0, 1 << 22, 400)
    await check_sound(
        dut, [one(packets.points_at(rng.normal(0, 100, (400, 3)), rng.integers(0, 16, 400), ticks), table)]
    )


@cocotb.test()
async def points_of_any_bits_are_answered(dut):
    """Nothing that a point's 128 bits can be stops the core or goes another way than the golden model's."""
    rng = np.random.default_rng(SEED)
    table = packets.any_table(rng, packets.breaks(rng, 20, packets.LAST_TICK))
    noise = rng.integers(0, 1 << 32, (1_000, 4), dtype=np.uint32)
    noise[::2, :3] = noise[::2, :3] & 0x83FFFFFF | rng.integers(0x38, 0x46, (500, 3), dtype=np.uint32) << 24
    await check_sound(dut, [one(noise, table, size=(255, 2048)), one(noise, size=(200, 1800))])


@cocotb.test()
async def the_next_table_leaves_points_in_flight_alone(dut):
    """Back to back, and short, so that tables are written while points of the packets before are searched."""
    rng = np.random.default_rng(SEED)
    for points in (1, 2, 5, 12, 30):
        for segments in (1, 2, 3):
            await check_sound(dut, [packets.random_packet(rng, points, segments) for _ in range(4)])


@cocotb.test()
async def a_table_cut_short_leaves_points_in_flight_alone(dut):
    """The shortest way to the bank of points in flight: a packet cut in its table, and then the next table."""
    rng = np.random.default_rng(SEED)
    first, cut, last = (packets.random_packet(rng, 12, 2) for _ in range(3))
    short = cut.beats()[:3]
    refused = packets.refusal(short, packet.TRUNCATED)
    await check(dut, [first.beats(), short, last.beats()], [first.answer(), refused, last.answer()])


@cocotb.test()
async def without_segments_points_stay_where_they_are(dut):
    rng = np.random.default_rng(SEED)
    await check_sound(dut, [packets.random_packet(rng, 20, s) for s in (3, 0, 4, 0, 0, 2)])


@cocotb.test()
async def the_bypass_bit_leaves_points_where_they_are(dut):
    rng = np.random.default_rng(SEED)
    await check_sound(dut, [packets.random_packet(rng, 20, 3, flags=f) for f in (0, packet.BYPASS_DESKEW, 0, 2)])


@cocotb.test()
async def a_packet_without_points_is_answered(dut):
    rng = np.random.default_rng(SEED)
    shapes = [(5, 2), (0, 3), (0, 0), (0, 0), (4, 1), (0, 1), (0, 2), (9, 3)]
    await check_sound(dut, [packets.random_packet(rng, n, s) for n, s in shapes])


@cocotb.test()
async def before_the_first_break_its_pose_is_held(dut):
    rng = np.random.default_rng(SEED)
    table = packets.motion(rng, np.array([5_000, 9_000, 20_000], np.int32))
    ticks = np.arange(0, 5_020, 17)
    await check_sound(dut, [one(packets.points_at(rng.normal(0, 9, (len(ticks), 3)), 1, ticks), table)])


@cocotb.test()
async def times_before_at_and_after_every_break_find_their_segment(dut):
    rng = np.random.default_rng(SEED)
    sent = []
    for segments in (1, 2, 3, 7, 8, 31, 64, 100):
        table = packets.motion(rng, packets.breaks(rng, segments, packets.LAST_TICK))
        ticks = packets.ticks_around(table[:, 0])
        sent.append(one(packets.points_at(rng.normal(0, 9, (len(ticks), 3)), 1, ticks), table))
    await check_sound(dut, sent)


@cocotb.test()
async def a_table_of_256_segments_fits(dut):
    rng = np.random.default_rng(SEED)
    table = packets.motion(rng, packets.breaks(rng, packet.MAX_SEGMENTS, packets.LAST_TICK))
    ticks = packets.ticks_around(table[:, 0])
    full = one(packets.points_at(rng.normal(0, 9, (len(ticks), 3)), 1, ticks), table)
    await check_sound(dut, [full, packets.random_packet(rng, 9, 1), packets.random_packet(rng, 9, 255)])


@cocotb.test()
async def breaks_at_the_same_tick_give_way_to_the_last(dut):
    rng = np.random.default_rng(SEED)
    table = packets.motion(rng, np.array([0, 50, 50, 50, 90, 90], np.int32))
    await check_sound(dut, [one(packets.points_at(rng.normal(0, 9, (120, 3)), 1, np.arange(120)), table)])


@cocotb.test()
async def numbers_that_are_none_make_a_point_unusable(dut):
    """NaN of all kinds, infinities, zeros, denormals, and both sides of every limit of the formats."""
    below_512 = np.nextafter(np.float32(512), np.float32(0))
    below_half_step = np.nextafter(np.float32(2**-15), np.float32(0))
    magnitudes = [np.nan, np.inf, 0, 1e-45, 1e-38, below_half_step, 2**-15, 2**-16, 1.5]
    magnitudes += [255.99, 256, 511.9, 512 - 2**-15, below_512, 512, 1e9, 3.4e38]
    values = np.array(magnitudes + [-m for m in magnitudes], np.float32)
    signalling = np.array([0x7F800001, 0xFFC00001], np.uint32).view(np.float32)
    values = np.concatenate([values, signalling])
    xyz = np.stack(np.meshgrid(values, values, [0, 3, np.nan, -600]), -1).reshape(-1, 3)
    rng = np.random.default_rng(SEED)
    table = packets.motion(rng, np.array([0], np.int32))
    with np.errstate(invalid="ignore"):
        await check_sound(dut, [one(packets.points_at(xyz, 2, 100), table), one(packets.points_at(xyz, 2, 100))])


@cocotb.test()
async def rings_outside_of_the_image_are_marked(dut):
    rng = np.random.default_rng(SEED)
    sent = [
        one(packets.points_at(rng.normal(0, 9, (256, 3)), np.arange(256)), size=(r, 1024)) for r in (1, 16, 128, 255)
    ]
    await check_sound(dut, sent)


@cocotb.test()
async def moved_points_saturate(dut):
    """Far out, turned and pushed further: +-512 m on every axis, and just inside."""
    table = np.zeros((1, 28), np.int32)
    table[0, 4:16] = np.round(np.eye(3, 4) * (1 << 25)).ravel()
    table[0, [7, 11, 15]] = 1 << 22  # 16 m
    edge = np.array([495.9, 495.99997, 496, 496.0001, 511, 100], np.float32)
    xyz = np.concatenate([np.stack(np.meshgrid(edge, edge, edge), -1).reshape(-1, 3)] * 2)
    out = one(packets.points_at(xyz), table)
    back = table.copy()
    back[0, [7, 11, 15]] *= -1
    await check_sound(dut, [out, one(packets.points_at(-xyz), back)])


@cocotb.test()
async def azimuths_on_axes_and_column_borders_round_as_told(dut):
    for rings, columns in [*packets.SIZES, (32, 512), (16, 2), (16, 4094)]:
        turn = np.concatenate([(np.arange(64) + 0.5) / columns, np.arange(8) / 8, np.arange(64) / 64])
        xyz = np.stack([7 * np.cos(2 * np.pi * turn), 7 * np.sin(2 * np.pi * turn), 0 * turn], 1)
        axes = [[a, b, c] for a in (-3, 0, 3, -1e-4) for b in (-3, 0, 3, 1e-4) for c in (0, 5)]
        await check_sound(dut, [one(packets.points_at(np.concatenate([xyz, axes]), 1), size=(rings, columns))])


@cocotb.test()
async def a_packet_cut_short_is_refused_and_the_next_one_is_right(dut):
    """Cut after every beat of header and table."""
    rng = np.random.default_rng(SEED)
    before, cut, after = (packets.random_packet(rng, n, s) for n, s in ((7, 2), (5, 3), (9, 2)))
    whole = cut.beats()
    for length in range(1, 2 + 3 * packet.SEGMENT_BEATS):
        refused = packets.refusal(whole[:length], packet.TRUNCATED)
        sent = [before.beats(), whole[:length], after.beats()]
        await check(dut, sent, [before.answer(), refused, after.answer()], stall="half" if length % 2 else "never")


@cocotb.test()
async def bad_headers_are_refused_and_the_next_packet_is_right(dut):
    rng = np.random.default_rng(SEED)
    before, bad, after = (packets.random_packet(rng, n, s) for n, s in ((7, 2), (25, 3), (9, 2)))
    wrong = [
        ({"magic": 0x534D}, packet.BAD_HEADER),
        ({"version": 2}, packet.BAD_HEADER),
        ({"version": 0, "segments": 300}, packet.BAD_HEADER),
        ({"segments": 257}, packet.TOO_MANY_SEGMENTS),
        ({"segments": 0xFF00}, packet.TOO_MANY_SEGMENTS),
    ]
    for idle, stall in (("never", "never"), ("half", "bursts")):
        for changes, status in wrong:
            lie = packets.with_header(bad.beats(), **changes)
            sent, expected = (
                [before.beats(), lie, after.beats()],
                [before.answer(), packets.refusal(lie, status), after.answer()],
            )
            await check(dut, sent, expected, idle, stall)
            only_header = lie[:2]
            await check(dut, [only_header, after.beats()], [packets.refusal(only_header, status), after.answer()])


@cocotb.test()
async def many_tiny_packets_wait_behind_a_long_stall(dut):
    """More headers than the pipeline and the FIFO hold, and nobody who takes them for a while."""
    rng = np.random.default_rng(SEED)
    sent = [packets.random_packet(rng, n % 3, 0) for n in range(60)]
    stream = Stream(dut)
    await stream.reset()
    clocks = iter(range(10_000_000))
    got = await stream.run([p.beats() for p in sent], stall=lambda: next(clocks) < 400)
    assert all(np.array_equal(g, p.answer()) for g, p in zip(got, sent, strict=True))


@cocotb.test()
async def a_reset_in_the_middle_leaves_nothing_behind(dut):
    rng = np.random.default_rng(SEED)
    cut, after = packets.random_packet(rng, 60, 5), packets.random_packet(rng, 20, 3)
    for beats in (1, 2, 12, 40, 70):
        stream = Stream(dut)
        await stream.reset()
        await stream.feed(cut.beats()[:beats])
        await check_sound(dut, [after, after])


@cocotb.test()
async def takes_a_beat_a_clock(dut):
    """First beat in to last beat out: the beats, two for the trailer, and the latency, once."""
    rng = np.random.default_rng(SEED)
    short, long = packets.random_packet(rng, 10, 8), packets.random_packet(rng, 1_000, 8)
    clocks = {}
    for p in (short, long):
        stream = await check_sound(dut, [p])
        clocks[len(p.points)] = stream.clocks
    assert clocks[1_000] - clocks[10] == 990, clocks
    latency = clocks[10] - len(short.beats()) - packet.TRAILER_BEATS
    dut._log.warning("latency: %d clocks", latency)
    assert latency <= tolerances.DESKEW_CORE_LATENCY


@cocotb.test()
async def a_whole_scan_is_right_to_half_a_millimetre_within_31_000_clocks(dut):
    """28,800 points at 100 m, 217 deg/s, 250 segments: first beat in to last beat out, header and table included."""
    scan = turning_scan()
    assert (len(scan.packet.table), len(scan.packet.points)) == (250, 28_800)
    stream = Stream(dut)
    await stream.reset()
    (answer,) = await stream.run([scan.packet.beats()])
    np.testing.assert_array_equal(answer, scan.packet.answer())
    clocks, error_m = stream.clocks, scan.error_m(answer).max()
    dut._log.warning("28,800 points: %d clocks, %.3f mm at the most", clocks, error_m * 1e3)
    assert clocks <= tolerances.DESKEW_CORE_CLOCKS
    assert error_m <= tolerances.DESKEW_CORE_M
