"""A core on Verilator as an object that takes packets and answers them, clock by clock."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fpga_overlay.cosim.build import library
from fpga_overlay.golden.packet import Beats

_OUTCOMES = {1: "hung", 2: "answered more than can be", 3: "changed or withdrew a beat before it was taken"}
_RESET_CYCLES = 16


class CoreError(Exception):
    """The core broke the stream's rules, or never answered."""


class _Exchange(ctypes.Structure):
    _fields_ = [
        ("in_", ctypes.c_void_p),
        ("in_last", ctypes.c_void_p),
        ("in_beats", ctypes.c_int64),
        ("out", ctypes.c_void_p),
        ("out_last", ctypes.c_void_p),
        ("out_capacity", ctypes.c_int64),
        ("out_packets", ctypes.c_int64),
        ("max_cycles", ctypes.c_int64),
        ("idle", ctypes.c_uint32),
        ("stall", ctypes.c_uint32),
        ("seed", ctypes.c_uint32),
        ("taken", ctypes.c_int64),
        ("given", ctypes.c_int64),
        ("cycles", ctypes.c_int64),
    ]


class VerilatedTop:
    """One instance of a core, out of reset and ready. Its state lives from one call to the next."""

    def __init__(
        self,
        rings: int | None = None,
        columns: int | None = None,
        top: str = "splitslam_top",
        sources: Sequence[Path] | None = None,
        seed: int = 1,
    ) -> None:
        """rings, columns: the module's parameters RINGS and COLUMNS; None: its own. Builds if need be."""
        given = {"RINGS": rings, "COLUMNS": columns}
        parameters = {name: value for name, value in given.items() if value is not None}
        self._library = _load(library(top, parameters, sources))
        self._core = self._library.core_new(seed)
        self._clear = 4 * (rings or 128) * (columns or 2048) + 10_000  # clocks: to clear an image, to read it out
        self.reset()

    def reset(self) -> int:
        """Pulls rst_n; returns the clocks after which the core took data. CoreError if it never does."""
        cycles = int(self._library.core_reset(self._core, _RESET_CYCLES, self._clear))
        if cycles < 0:
            raise CoreError(f"not ready {self._clear} clocks after reset")
        return cycles

    def run(
        self, beats: Beats, idle: float = 0.0, stall: float = 0.0, seed: int = 0, max_cycles: int | None = None
    ) -> tuple[Beats, int]:
        """One packet, (B, 4) uint32 with TLAST on the last, and its answer; and the clocks from first to last.

        idle, stall: chance that the source or the sink pauses for a clock. CoreError: no answer within max_cycles.
        """
        answers, cycles = self.run_many([beats], idle, stall, seed, max_cycles)
        return answers[0], cycles

    def run_many(
        self,
        packets: Sequence[Beats],
        idle: float = 0.0,
        stall: float = 0.0,
        seed: int = 0,
        max_cycles: int | None = None,
    ) -> tuple[list[Beats], int]:
        """Packets back to back, each with an answer; and the clocks of all. See run."""
        beats = np.ascontiguousarray(np.concatenate(packets), np.uint32)
        last = np.zeros(len(beats), np.uint8)
        last[np.cumsum([len(p) for p in packets]) - 1] = 1
        capacity = 2 * len(beats) + 64 * len(packets)
        out, out_last = np.empty((capacity, 4), np.uint32), np.empty(capacity, np.uint8)
        if max_cycles is None:
            share = max(0.01, (1 - idle) * (1 - stall))
            max_cycles = int(4 * capacity / share) + len(packets) * int(self._clear / share)
        exchange = _Exchange(
            beats.ctypes.data, last.ctypes.data, len(beats), out.ctypes.data, out_last.ctypes.data, capacity,
            len(packets), max_cycles, _chance(idle), _chance(stall), seed,
        )  # fmt: skip
        outcome = self._library.core_exchange(self._core, ctypes.byref(exchange))
        if outcome:
            seen = f"{exchange.taken} of {len(beats)} beats taken, {exchange.given} given"
            raise CoreError(f"{_OUTCOMES[outcome]} after {exchange.cycles} clocks: {seen}")
        ends = np.flatnonzero(out_last[: exchange.given]) + 1
        return np.split(out[: exchange.given], ends[:-1]), int(exchange.cycles)

    def close(self) -> None:
        """Ends the model; nothing else may follow."""
        core, self._core = self._core, None
        if core is not None:
            self._library.core_delete(core)

    def __del__(self) -> None:
        if getattr(self, "_core", None) is not None:
            self.close()


def _chance(share: float) -> int:
    return min(int(share * 2**32), 2**32 - 1)


def _load(path: Path) -> ctypes.CDLL:
    found = ctypes.CDLL(str(path))
    found.core_new.argtypes, found.core_new.restype = [ctypes.c_int32], ctypes.c_void_p
    found.core_delete.argtypes, found.core_delete.restype = [ctypes.c_void_p], None
    found.core_reset.argtypes = [ctypes.c_void_p, ctypes.c_int64, ctypes.c_int64]
    found.core_reset.restype = ctypes.c_int64
    found.core_exchange.argtypes = [ctypes.c_void_p, ctypes.POINTER(_Exchange)]
    found.core_exchange.restype = ctypes.c_int32
    return found
