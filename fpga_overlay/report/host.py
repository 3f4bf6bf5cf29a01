"""What the driver costs this machine's processor for one scan: its own code and PYNQ's, the answer being there.

The buffers are ordinary memory and the registers an array that always says `idle`, so that all the time measured is
the driver's. What the board adds, caches, registers and the wait, is in `report.board`.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np

from edge_agent.features.integer import FeatureMarks, Limits
from edge_agent.features.projection import Projector
from edge_agent.settings import FeatureSettings
from fpga_overlay.driver.accelerator import Accelerator
from fpga_overlay.driver.dma import DmaLink, import_pynq
from fpga_overlay.driver.request import ROOM_BEATS, RequestWriter
from fpga_overlay.golden.packet import BYPASS_FEATURES, Beats
from splitslam.features import Knots
from splitslam.scan import Scan

_IDLE = 0x2  # of a channel's status register
_STATUS = (0x04, 0x34)
_LENGTH_BITS = 26


@dataclass(frozen=True, slots=True)
class HostCost:
    """CPU time of one scan, best of several, ms on this machine; and what the board will add to.

    write: motion resampled, scan packed. exchange: both channels started and waited for, by PYNQ. marks: the Feature
    node's, where the logic makes none. total: a whole Accelerator.run; the rest of it reads the answer. registers:
    accesses to the DMA. sent, received: the buffers, whose caches are written back and dropped.
    """

    write: float
    exchange: float
    marks: float
    total: float
    registers: int
    sent: Beats
    received: Beats

    @property
    def read(self) -> float:
        """The answer checked and unpacked."""
        return self.total - self.write - self.exchange - self.marks


def host_cost(scan: Scan, knots: Knots, answer: Beats, rings: int, columns: int, *, features: bool) -> HostCost:
    """answer: the cores' to this scan and motion, whatever its sequence."""
    limits = Limits.of(FeatureSettings())
    link = RecordedLink(answer)
    accelerator = Accelerator(link, rings, columns, limits, features)
    writer = RequestWriter(rings, columns, limits, 0 if features else BYPASS_FEATURES)
    beats = np.empty((ROOM_BEATS + len(scan), 4), np.uint32)
    accelerator.run(scan, knots)  # compiles, and allocates the buffers
    link.mmio.accesses.clear()
    accelerator.run(scan, knots)
    registers = link.mmio.accesses.total()
    cost = HostCost(
        write=best_ms(lambda: writer.write(scan, knots, 1, beats)),
        exchange=best_ms(lambda: (link.exchange(len(scan), len(scan)), link.finish_sending())),
        marks=0.0 if features else marks_ms(scan, rings, columns, limits),
        total=best_ms(lambda: accelerator.run(scan, knots)),
        registers=registers,
        sent=link.request,
        received=link.answer,
    )
    accelerator.close()
    return cost


def marks_ms(scan: Scan, rings: int, columns: int, limits: Limits) -> float:
    """The Feature node's marks of a scan, on this processor."""
    image = Projector(rings, columns).project(scan)
    assert image.range_q is not None
    arguments = image.range_q, image.column, image.ring_start, limits
    out = FeatureMarks.of(*arguments)
    return best_ms(lambda: FeatureMarks.of(*arguments, out))


def best_ms(work: Callable[[], Any], repeats: int = 200) -> float:
    """The shortest CPU time of this thread that `work` took."""
    best = float("inf")
    for _ in range(repeats):
        start = time.thread_time_ns()
        work()
        best = min(best, (time.thread_time_ns() - start) * 1e-6)
    return best


class IdleLink(DmaLink):
    """The driver's link over PYNQ's channels, with a DMA that is always done."""

    def __init__(self, longest_beats: int) -> None:
        import_pynq()
        from pynq.lib.dma import DMA_TYPE_RX, DMA_TYPE_TX, _SDMAChannel

        self.mmio = Registers()
        most = 1 << _LENGTH_BITS
        receive = _SDMAChannel(self.mmio, most, 16, DMA_TYPE_RX, False)
        send = _SDMAChannel(self.mmio, most, 16, DMA_TYPE_TX, False)
        dma = SimpleNamespace(recvchannel=receive, sendchannel=send, buffer_max_size=most, mmio=self.mmio)
        super().__init__(SimpleNamespace(device=Memory(), axi_dma_0=dma), longest_beats)

    @property
    def answer(self) -> Beats:
        """All of the receive buffer."""
        return self._answer


class RecordedLink(IdleLink):
    """With an answer that is always there."""

    def __init__(self, answer: Beats) -> None:
        super().__init__(len(answer))
        self._recorded = answer
        self._filled = False

    def exchange(self, send_beats: int, receive_beats: int) -> Beats:
        """See DmaLink: what was recorded, under the request's sequence."""
        super().exchange(send_beats, receive_beats)
        answer = self._answer[: len(self._recorded)]
        if not self._filled:
            answer[:] = self._recorded
            self._filled = True
        answer[0, 3] = answer[-2, 3] = self.request[0, 3]
        return answer


class Registers:
    """Of an idle DMA: PYNQ's own MMIO over an array, its accesses counted."""

    def __init__(self) -> None:
        from pynq import MMIO

        words = np.zeros(0x60 // 4, np.uint32)
        for status in _STATUS:
            words[status // 4] = _IDLE
        device = SimpleNamespace(has_capability=lambda name: name == "MEMORY_MAPPED", mmap=lambda base, length: words)
        self._mmio = MMIO(0xA0000000, words.nbytes, device=device)
        self.accesses: Counter[str] = Counter()

    def read(self, offset: int) -> int:
        """See pynq.MMIO."""
        self.accesses["read"] += 1
        return self._mmio.read(offset)

    def write(self, offset: int, value: int) -> None:
        """See pynq.MMIO; a status register keeps saying `idle`."""
        self.accesses["write"] += 1
        if offset not in _STATUS:
            self._mmio.write(offset, value)


class Memory:
    """A device that allocates ordinary memory."""

    def allocate(self, shape: Any, dtype: Any, **_: Any) -> Buffer:
        """See pynq.allocate."""
        return np.zeros(shape, dtype).view(Buffer)


class Buffer(np.ndarray):
    """A PYNQ buffer without a cache to look after."""

    physical_address = 0x10000000

    def flush(self) -> None:
        """Nothing to do."""

    def invalidate(self) -> None:
        """Nothing to do."""
