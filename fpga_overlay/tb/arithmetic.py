"""cocotb: the arithmetic blocks of the deskew core alone, a test for each: corner cases and random numbers."""

from __future__ import annotations

import math

import cocotb
import numpy as np

from fpga_overlay.golden import cordic, fixed
from fpga_overlay.tb.pipeline import signed, through

RNG = np.random.default_rng(11)
LARGEST = (1 << 23) - 1


@cocotb.test()
async def float_to_fixed(dut):
    """Every exponent with fractions at all its edges, both signs; then random floats of the formats' range."""
    exponents = np.arange(256)
    fractions = np.array([0, 1, 2, 0x3FFFFF, 0x400000, 0x400001, 0x7FFFFE, 0x7FFFFF])
    edges = (exponents[:, None] << 23 | fractions).ravel()
    random = RNG.integers(100 << 23, 140 << 23, 3_000)
    bits = np.concatenate([edges, edges | 1 << 31, random, random | 1 << 31]).astype(np.uint32)
    q, fits = fixed.from_float32(bits.view(np.float32))
    got = await through(dut, 4, "q fits", number=bits.astype(np.int64))
    np.testing.assert_array_equal(signed(got["q"], 24), q)
    np.testing.assert_array_equal(got["fits"], fits)


@cocotb.test()
async def isqrt(dut):
    """Squares, their neighbours, both ends, and random numbers of every length."""
    roots = np.concatenate([np.arange(70), 1 << np.arange(1, 18), RNG.integers(0, 1 << 18, 1_000), [(1 << 18) - 1]])
    squares = roots * roots
    random = RNG.integers(0, 1 << 36, 2_000) >> RNG.integers(0, 36, 2_000)
    numbers = np.concatenate([squares, np.maximum(squares - 1, 0), squares + 1, random, [(1 << 36) - 1]])
    got = await through(dut, 18, "root", radicand=numbers)
    np.testing.assert_array_equal(got["root"], [math.isqrt(int(n)) for n in numbers])


@cocotb.test()
async def cordic_azimuth(dut):
    """Axes, diagonals and the largest numbers; random points of every size, near the axes too."""
    corners = np.array([0, 1, 2, 3, 1 << 22, (1 << 22) - 1, LARGEST - 1, LARGEST])
    corners = np.concatenate([corners, -corners])
    xy = np.stack(np.meshgrid(corners, corners), -1).reshape(-1, 2)
    random = RNG.integers(-LARGEST, LARGEST + 1, (4_000, 2))
    random[::2] >>= RNG.integers(0, 23, (2_000, 1))
    random[::5] >>= RNG.integers(0, 23, (800, 2))
    xy = np.concatenate([xy, random])
    got = await through(dut, 26, "angle", x=xy[:, 0], y=xy[:, 1])
    np.testing.assert_array_equal(signed(got["angle"], 27), cordic.azimuth(xy[:, 0], xy[:, 1]))


@cocotb.test()
async def column_of_azimuth(dut):
    """All over the turn and around every border between columns, for narrow and wide images."""
    half = 1 << 26
    for columns in (2, 512, 1800, 2048, 4094):
        border = (np.arange(-columns, columns) * (1 << 27)) // (2 * columns)
        near = (border[RNG.integers(0, len(border), 300), None] + np.arange(-1, 3)).ravel()
        angles = np.clip(np.concatenate([near, RNG.integers(-half, half, 300), [-half, half - 1, 0]]), -half, half - 1)
        got = await through(dut, 4, "column", angle=angles, columns=np.full(len(angles), columns))
        np.testing.assert_array_equal(got["column"], cordic.column_of(angles, columns))


@cocotb.test()
async def dot_row(dut):
    """Random numbers and the ends of every format, saturation included, against Python's integers."""
    ends = np.array([-(1 << 26), (1 << 26) - 1, -1, 0, 1, 1 << 25])
    m = np.where(
        RNG.random((4_000, 4)) < 0.3, RNG.choice(ends, (4_000, 4)), RNG.integers(-(1 << 26), 1 << 26, (4_000, 4))
    )
    m[::2] >>= RNG.integers(0, 12, (2_000, 1))
    p = np.where(RNG.random((4_000, 3)) < 0.3, RNG.choice([-LARGEST, LARGEST, 0, 1 << 17, -1], (4_000, 3)), 0)
    p = np.where(p == 0, RNG.integers(-LARGEST, LARGEST + 1, (4_000, 3)), p)
    rows = [sum((int(v) & 0x7FFFFFF) << 27 * k for k, v in enumerate(row)) for row in m]
    total = (m[:, :3] * p).sum(axis=1) + (m[:, 3] << 21)
    want = np.clip((total + (1 << 24)) >> 25, -LARGEST, LARGEST)
    got = await through(dut, 6, "moved", row=rows, x=p[:, 0], y=p[:, 1], z=p[:, 2])
    np.testing.assert_array_equal(signed(got["moved"], 24), want)
    assert 100 < np.count_nonzero(np.abs(want) == LARGEST) < 3_000
