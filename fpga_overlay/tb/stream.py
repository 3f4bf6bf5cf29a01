"""AXI4-Stream source and sink for cocotb, a clock each: packets in, packets out, with idle and stall patterns.

One coroutine owns the clock, the source and the sink, so a clock costs two simulator calls and nothing races: inputs
change right after the falling edge, outputs are read right before the rising one. It also holds the core to the
protocol: what is offered (tvalid, tdata, tlast) stays until it is taken, and nothing is offered in reset.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from cocotb.triggers import Timer

from fpga_overlay.golden.packet import Beats

Pattern = Callable[[], bool]

IDLE_PATTERNS = ("never", "half", "bursts")


def pattern(name: str, seed: int = 0) -> Pattern:
    """Says clock by clock whether to pause: never; half of the clocks at random; in bursts of up to 20 clocks."""
    rng = random.Random(seed)
    if name == "never":
        return lambda: False
    if name == "half":
        return lambda: rng.random() < 0.5
    if name == "bursts":
        state = {"left": 0, "pause": False}

        def step() -> bool:
            if state["left"] == 0:
                state["pause"] = not state["pause"]
                state["left"] = rng.randint(1, 20)
            state["left"] -= 1
            return state["pause"]

        return step
    raise ValueError(f"pattern {name!r}: expected one of {IDLE_PATTERNS}")


def to_ints(beats: Beats) -> list[int]:
    """(B, 4) uint32 -> a 128-bit number a beat."""
    return [int.from_bytes(row.tobytes(), "little") for row in np.ascontiguousarray(beats, np.uint32)]


def to_beats(words: Sequence[int]) -> Beats:
    """The inverse of to_ints."""
    data = b"".join(word.to_bytes(16, "little") for word in words)
    return np.frombuffer(data, np.uint32).reshape(-1, 4)


class Stream:
    """Drives `dut`: clk, rst_n, s_axis_t{data,valid,ready,last}, m_axis_t{data,valid,ready,last}."""

    def __init__(self, dut: Any) -> None:
        self.dut = dut
        self.cycles = 0
        self.first_in: int | None = None  # when the last `run` had its first beat in and its last beat out
        self.last_out = 0

    @property
    def clocks(self) -> int:
        """Of the last `run`: first beat in to last beat out, both included."""
        assert self.first_in is not None
        return self.last_out - self.first_in + 1

    async def reset(self, clocks: int = 4) -> None:
        """Leaves the core out of reset with nothing offered and nothing taken."""
        d = self.dut
        d.clk.value = 0
        d.rst_n.value = 0
        d.s_axis_tvalid.value = 0
        d.s_axis_tlast.value = 0
        d.m_axis_tready.value = 0
        for clock in range(clocks):
            await self._clock()
            assert clock == 0 or not int(d.m_axis_tvalid.value), "tvalid in reset"
        d.rst_n.value = 1

    async def run(
        self,
        packets: Sequence[Beats],
        idle: Pattern | None = None,
        stall: Pattern | None = None,
        answers: int | None = None,
        quiet_after: int = 50,
        limit: int | None = None,
    ) -> list[Beats]:
        """Sends packets back to back and returns the packets that come back: `answers` of them (one each).

        idle, stall: whether the source, the sink pauses in a clock. Then `quiet_after` clocks must bring nothing more.
        limit: clocks after which the core counts as hung, by default ample for random patterns.
        """
        d = self.dut
        idle, stall = idle or pattern("never"), stall or pattern("never")
        expected = len(packets) if answers is None else answers
        waiting = [(word, n + 1 == len(beats)) for beats in packets for n, word in enumerate(to_ints(beats))]
        limit = limit or 20 * len(waiting) + 20_000
        start, at, offered = self.cycles, 0, False
        done: list[Beats] = []
        words: list[int] = []
        held: tuple[int, int] | None = None
        quiet = 0
        self.first_in = None
        while quiet < quiet_after:
            assert self.cycles - start < limit, f"hung: {len(done)} of {expected} packets, {len(words)} beats after"
            if not offered:
                offered = at < len(waiting) and not idle()
                if offered:
                    d.s_axis_tdata.value, d.s_axis_tlast.value = waiting[at]
                d.s_axis_tvalid.value = offered
            ready = len(done) >= expected or not stall()
            d.m_axis_tready.value = ready
            await Timer(1, "ns")
            if offered and int(d.s_axis_tready.value):
                self.first_in = self.cycles if self.first_in is None else self.first_in
                at, offered = at + 1, False
            if int(d.m_axis_tvalid.value):
                beat = int(d.m_axis_tdata.value), int(d.m_axis_tlast.value)
                assert held is None or held == beat, "tdata or tlast changed before the beat was taken"
                held = None if ready else beat
                if ready:
                    assert len(done) < expected, "a beat after the last packet"
                    words.append(beat[0])
                    self.last_out = self.cycles
                    if beat[1]:
                        done.append(to_beats(words))
                        words = []
            else:
                assert held is None, "tvalid fell before the beat was taken"
            quiet = quiet + 1 if len(done) == expected and at == len(waiting) else 0
            await self._edge()
        return done

    async def feed(self, beats: Beats, limit: int = 1000) -> None:
        """Sends beats without TLAST and takes nothing: a packet that breaks off."""
        d = self.dut
        d.s_axis_tlast.value = 0
        d.m_axis_tready.value = 0
        for word in to_ints(beats):
            d.s_axis_tdata.value = word
            d.s_axis_tvalid.value = 1
            taken = False
            for _ in range(limit):
                await Timer(1, "ns")
                taken = bool(int(d.s_axis_tready.value))
                await self._edge()
                if taken:
                    break
            assert taken, "hung"
        d.s_axis_tvalid.value = 0

    async def _clock(self) -> None:
        await Timer(1, "ns")
        await self._edge()

    async def _edge(self) -> None:
        self.dut.clk.value = 1
        await Timer(1, "ns")
        self.dut.clk.value = 0
        self.cycles += 1
