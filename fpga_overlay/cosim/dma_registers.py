"""The AXI DMA in simple mode as its registers show it (AMD PG021, direct register mode): two channels, one reset.

Time does not pass here: a transfer is over when the register write that makes it possible returns, or never.
"""

from __future__ import annotations

from collections import deque
from typing import Protocol

import numpy as np

from fpga_overlay.golden.packet import Beats

CONTROL, STATUS, ADDRESS, ADDRESS_HIGH, LENGTH = 0x00, 0x04, 0x18, 0x1C, 0x28
RECEIVE = 0x30  # the S2MM channel's registers
RUN, RESET = 1 << 0, 1 << 2
HALTED, IDLE, INTERNAL_ERROR, DECODE_ERROR, DONE_IRQ = 1 << 0, 1 << 1, 1 << 4, 1 << 6, 1 << 12
_CONTROL_AFTER_RESET = 0x0001_0002


class Logic(Protocol):
    """What sits between the two streams."""

    def answer(self, beats: Beats) -> list[Beats]:
        """The packets that leave once this one has come in: normally one."""
        ...

    def reset(self) -> None:
        """The reset that the DMA passes on."""
        ...

    def close(self) -> None:
        """Nothing else may follow."""
        ...


class Memory(Protocol):
    """What the DMA's masters see."""

    def window(self, address: int, nbytes: int) -> np.ndarray | None:
        """(nbytes,) uint8, a view; None where there is no memory."""
        ...


class Channel:
    """The registers of one channel."""

    def __init__(self, length_bits: int) -> None:
        self._length_mask = (1 << length_bits) - 1
        self.reset()

    def reset(self) -> None:
        """Halted, nothing under way."""
        self.control, self.status = _CONTROL_AFTER_RESET, HALTED
        self.address = self.length = 0
        self.busy = False

    def read(self, offset: int) -> int:
        """A register."""
        known = {CONTROL: self.control, STATUS: self.status, LENGTH: self.length}
        known |= {ADDRESS: self.address & 0xFFFFFFFF, ADDRESS_HIGH: self.address >> 32}
        return known.get(offset, 0)

    def write(self, offset: int, value: int) -> None:
        """A register; a length starts a transfer."""
        if offset == CONTROL:
            self.control = value & ~RESET | 2
            self.status = self.status & ~HALTED if value & RUN else self.status | HALTED
            self.busy = self.busy and bool(value & RUN)
        elif offset == STATUS:
            self.status &= ~(value & DONE_IRQ)  # written as one to clear
        elif offset == ADDRESS:
            self.address = self.address & ~0xFFFFFFFF | value
        elif offset == ADDRESS_HIGH:
            self.address = self.address & 0xFFFFFFFF | value << 32
        elif offset == LENGTH and value & self._length_mask and not self.status & HALTED:
            self.length = value & self._length_mask
            self.status &= ~IDLE
            self.busy = True

    def finish(self, nbytes: int) -> None:
        """The transfer is over; nbytes can then be read back."""
        self.length, self.busy = nbytes, False
        self.status |= IDLE | DONE_IRQ

    def fail(self, error: int) -> None:
        """An error halts the channel until it is reset."""
        self.busy = False
        self.status |= error | HALTED


class DmaRegisters:
    """Both channels, with the logic between them."""

    def __init__(self, logic: Logic, memory: Memory, length_bits: int = 26) -> None:
        self.send, self.receive = Channel(length_bits), Channel(length_bits)
        self.log: list[tuple[int, int]] = []  # of writes: offset, value
        self._logic, self._memory = logic, memory
        self._under_way: deque[Beats] = deque()

    def read(self, offset: int) -> int:
        """A 32-bit register."""
        return self.receive.read(offset - RECEIVE) if offset >= RECEIVE else self.send.read(offset)

    def write(self, offset: int, value: int) -> None:
        """A 32-bit register, and what follows from it."""
        self.log.append((offset, value))
        if offset in (CONTROL, RECEIVE + CONTROL) and value & RESET:
            self.send.reset()
            self.receive.reset()
            self._under_way.clear()
            self._logic.reset()
        elif offset >= RECEIVE:
            self.receive.write(offset - RECEIVE, value)
        else:
            self.send.write(offset, value)
        self._flow()

    def _flow(self) -> None:
        """The logic holds little: data is taken from memory only while somebody receives."""
        if self.receive.busy and not self._under_way and self.send.busy:
            source = self._memory.window(self.send.address, self.send.length)
            if source is None:
                self.send.fail(DECODE_ERROR)
                return
            beats = source.copy().view(np.uint32).reshape(-1, 4)
            self._under_way.extend(self._logic.answer(beats))
            self.send.finish(self.send.length)
        if self.receive.busy and self._under_way:
            self._deliver(self._under_way.popleft())

    def _deliver(self, packet: Beats) -> None:
        octets = np.ascontiguousarray(packet).view(np.uint8).reshape(-1)
        target = self._memory.window(self.receive.address, self.receive.length)
        if target is None:
            self.receive.fail(DECODE_ERROR)
        elif len(octets) > len(target):
            target[:] = octets[: len(target)]
            self.receive.fail(INTERNAL_ERROR)
        else:
            target[: len(octets)] = octets
            self.receive.finish(len(octets))
