"""A model of the ZCU104 around the cores, for a prediction: nothing here was measured on a board.

Every figure names where it is from; those that are assumptions say so.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

from fpga_overlay.golden.packet import Beats
from splitslam.bench.paper import A53_FACTOR

MS_PER_NS = 1e-6


@dataclass(frozen=True, slots=True)
class Zcu104:
    """clock_mhz: of the logic, as the paper's.

    stream_share: of the clocks, in which memory gives and takes a beat of 128 bits. AMD PG022 5.1, Throughput: the
    DMA's engine sustains 97.75 % both ways at once over 1 MB. A port asks for 1.6 GB/s each way of a memory of 17 GB/s.
    (PG021 7.1 has 74.64 % for receiving 10,000 bytes, where the start counts; that is in start_clocks here.)
    start_clocks: of both channels (PG021 7.1, table 1), and 100 for the first read of the memory (assumed).
    cpu_factor: an A53 core of the board against a core of the machine that the report runs on (splitslam.bench.paper).
    line_bytes: of the A53's caches (ARM DDI 0500). line_ns: to write a line back, or to drop it and fetch it again: 1.6
    GB/s, assumed from the 800 MB/s that users report for a copy between cached buffers (ikwzm/udmabuf, issue 16).
    register_ns: one access to a register of the DMA (assumed: some 20 clocks of the logic). wake_us: from the interrupt
    to the waiting thread (assumed).
    """

    clock_mhz: float = 100.0
    stream_share: float = 0.9775
    start_clocks: int = 6 + 39 + 100
    cpu_factor: float = A53_FACTOR
    line_bytes: int = 64
    line_ns: float = 40.0
    register_ns: float = 200.0
    wake_us: float = 50.0

    def clocks_ms(self, clocks: int) -> float:
        """Of the logic."""
        return clocks / self.clock_mhz * 1e-3

    def cache_ms(self, beats: Beats) -> float:
        """To write back, or to drop, what lies in the caches of a buffer with these beats."""
        return -(-beats.nbytes // self.line_bytes) * self.line_ns * MS_PER_NS

    def processor_ms(self, cpu_ms_here: float) -> float:
        """Work on this machine's processor, on one A53 core."""
        return cpu_ms_here * self.cpu_factor

    def as_json(self) -> dict[str, float]:
        """Its figures by name."""
        return asdict(self)
