"""Drives a pipeline without handshake, which takes and gives a set of numbers every clock."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from cocotb.triggers import Timer

from fpga_overlay.golden.fixed import Ints


async def through(dut: Any, latency: int, outputs: str | list[str], **inputs: Sequence[int] | Ints) -> dict[str, Ints]:
    """What comes out `latency` clocks after each set of inputs, as unsigned numbers. inputs: port -> (N,)."""
    names = outputs.split() if isinstance(outputs, str) else outputs
    count = len(next(iter(inputs.values())))
    columns: Mapping[str, list[int]] = {
        name: [int(v) & ((1 << len(getattr(dut, name))) - 1) for v in values] for name, values in inputs.items()
    }
    got: dict[str, list[int]] = {name: [] for name in names}
    dut.clk.value = 0
    for clock in range(count + latency):
        if clock < count:
            for name, values in columns.items():
                getattr(dut, name).value = values[clock]
        await Timer(1, "ns")
        dut.clk.value = 1
        await Timer(1, "ns")
        dut.clk.value = 0
        if clock >= latency - 1 and len(got[names[0]]) < count:
            for name in names:
                got[name].append(int(getattr(dut, name).value))
    return {name: np.array(values, np.int64) for name, values in got.items()}


def signed(values: Ints, bits: int) -> Ints:
    """Numbers of `bits` bits read as two's complement."""
    return np.where(values >> (bits - 1) & 1, values - (1 << bits), values)
