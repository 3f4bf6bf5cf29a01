"""Sends packets through a core and compares what comes back, beat by beat."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from cocotb.handle import SimHandleBase

from fpga_overlay.golden.packet import Beats
from fpga_overlay.tb.stream import Stream, pattern

Exchange = tuple[Beats, Beats]  # a packet to the core, and what must come back


async def check(
    dut: SimHandleBase, exchanges: Sequence[Exchange], idle: str = "never", stall: str = "never", seed: int = 1
) -> Stream:
    """Packets back to back into a core fresh from reset."""
    stream = Stream(dut)
    await stream.reset()
    await go_on(stream, exchanges, idle, stall, seed)
    return stream


async def go_on(
    stream: Stream, exchanges: Sequence[Exchange], idle: str = "never", stall: str = "never", seed: int = 1
) -> None:
    """Packets back to back into a core as it is."""
    answers = await stream.run([sent for sent, _ in exchanges], pattern(idle, seed), pattern(stall, seed + 1))
    for n, (got, (_, want)) in enumerate(zip(answers, exchanges, strict=True)):
        assert got.shape == want.shape, f"packet {n}: {len(got)} beats, expected {len(want)}"
        wrong = np.flatnonzero((got != want).any(axis=1))
        assert not len(wrong), (
            f"packet {n}: {len(wrong)} of {len(want)} beats differ, first {wrong[0]}: "
            f"{_text(got[wrong[0]])}, expected {_text(want[wrong[0]])}"
        )


def _text(beat: np.ndarray) -> str:
    return " ".join(f"{word:08x}" for word in beat)
