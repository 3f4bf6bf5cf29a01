"""A board without a board: the cores and the AXI DMA behind PYNQ's own device interface, for the unmodified driver."""

from __future__ import annotations

import ctypes
import importlib
import itertools
import logging
from pathlib import Path

import numpy as np

from fpga_overlay.cosim.dma_registers import DmaRegisters, Logic
from fpga_overlay.driver.dma import import_pynq
from fpga_overlay.golden import features
from fpga_overlay.golden.packet import HEADER_BEATS, SEGMENT_BEATS, Beats, Header

pynq = import_pynq()

HANDOFF = Path(__file__).with_name("splitslam.hwh")
_DMA_BASE, _DMA_SIZE = 0xA000_0000, 0x1_0000  # as in the hand-off
_FIRST_ADDRESS, _PAGE = 0x1000_0000, 4096
_numbers = itertools.count()
_log = logging.getLogger(__name__)


class GoldenLogic:
    """The integer golden model in the cores' place: fast, for what is not about RTL."""

    def answer(self, beats: Beats) -> list[Beats]:
        """See Logic."""
        header = header_of(beats)
        first = HEADER_BEATS + header.segments * SEGMENT_BEATS
        table = beats[HEADER_BEATS:first].reshape(header.segments, 4 * SEGMENT_BEATS).view(np.int32)
        return [features.answer(header, table, beats[first:])]

    def reset(self) -> None:
        """It has no state."""

    def close(self) -> None:
        """It holds nothing."""


class VerilatedLogic:
    """The RTL, for one size of image. cycles: of every packet that was answered."""

    def __init__(self, rings: int, columns: int) -> None:
        """InputError: it cannot be built here. Storage is of powers of two, so the same library serves many sensors."""
        from fpga_overlay.cosim.verilated import VerilatedTop

        self.cycles: list[int] = []
        self._top = VerilatedTop(_power_of_two(max(rings, 2)), _power_of_two(max(columns, 4)))

    def answer(self, beats: Beats) -> list[Beats]:
        """See Logic; a core that hangs answers nothing, as on a board."""
        from fpga_overlay.cosim.verilated import CoreError

        try:
            answer, cycles = self._top.run(beats)
        except CoreError as error:
            _log.error("the core %s", error)
            return []
        self.cycles.append(cycles)
        return [answer]

    def reset(self) -> None:
        """See Logic."""
        self._top.reset()

    def close(self) -> None:
        """Ends the model."""
        self._top.close()


class CosimDevice(pynq.Device):
    """Registers, memory with a cache in front of it, and `download`, which resets the logic.

    What the processor writes reaches the DMA when it is flushed; what the DMA writes is seen when it is invalidated.
    """

    def __init__(self, logic: Logic, bitstream: Path = HANDOFF) -> None:
        """bitstream: the hand-off itself, there being no bits; PYNQ reads it from there."""
        super().__init__(f"cosim-{next(_numbers)}")
        self.capabilities = {"REGISTER_RW": True}
        self.bitstream, self.logic = bitstream, logic
        self.memory: dict[int, np.ndarray] = {}
        self._next_address = _FIRST_ADDRESS
        self.dma = DmaRegisters(logic, self)

    # what PYNQ calls

    def get_bitfile_metadata(self, bitfile_name: str, partial: bool = False):
        """The hand-off as PYNQ's runtime sees it."""
        metadata = importlib.import_module("pynqmetadata.frontends").Metadata(input=Path(bitfile_name))
        parser = importlib.import_module("pynqmetadata.views.runtime").RuntimeMetadataParser(metadata)
        parser.clock_dict = {}  # there is no processing system whose clocks could be set
        return parser

    def download(self, bitstream, parser=None) -> None:
        """Loads nothing, and resets."""
        self.logic.reset()
        self.post_download(bitstream, parser)

    def read_registers(self, address: int, length: int) -> bytes:
        """Of the DMA, a word at a time."""
        return b"".join(self.dma.read(o).to_bytes(4, "little") for o in self._offsets(address, length))

    def write_registers(self, address: int, data: bytes) -> None:
        """Of the DMA, a word at a time."""
        words = np.frombuffer(bytes(data), "<u4")
        for offset, word in zip(self._offsets(address, 4 * len(words)), words, strict=True):
            self.dma.write(offset, int(word))

    def allocate(self, shape, dtype, cacheable: int = 0, **_):
        """A buffer with an address of its own; one that is not cacheable would be a waste here, and is refused."""
        assert cacheable, "uncached memory is slow to read on a board"
        size = int(np.prod(shape)) * np.dtype(dtype).itemsize
        address, self._next_address = self._next_address, self._next_address + -(-size // _PAGE) * _PAGE
        self.memory[address] = np.full(size, 0xA5, np.uint8)
        made = pynq.buffer.PynqBuffer(shape, dtype, device=self, device_address=address, bo=address, coherent=False)
        made.view(np.ndarray)[...] = 0x5A
        return made

    def flush(self, bo: int, offset: int, vaddr: int, nbytes: int) -> None:
        """Cache to memory."""
        self.memory[bo][offset : offset + nbytes] = _octets(vaddr, nbytes)

    def invalidate(self, bo: int, offset: int, vaddr: int, nbytes: int) -> None:
        """Memory to cache."""
        _octets(vaddr, nbytes)[:] = self.memory[bo][offset : offset + nbytes]

    # what the DMA calls

    def window(self, address: int, nbytes: int) -> np.ndarray | None:
        """See Memory."""
        for base, memory in self.memory.items():
            if base <= address and address + nbytes <= base + len(memory):
                return memory[address - base : address - base + nbytes]
        return None

    def close(self) -> None:
        """Ends the logic."""
        self.logic.close()
        self.memory.clear()

    @staticmethod
    def _offsets(address: int, length: int) -> range:
        assert _DMA_BASE <= address <= address + length <= _DMA_BASE + _DMA_SIZE, f"nothing is at {address:#x}"
        return range(address - _DMA_BASE, address - _DMA_BASE + length, 4)


def header_of(beats: Beats) -> Header:
    """The header that a sound packet begins with."""
    (flags, sizes, geometry, sequence), (occlusion, corner, flat, _) = (map(int, beat) for beat in beats[:2])
    return Header(
        rings=geometry & 0xFF,
        columns=geometry >> 16 & 0xFFF,
        segments=sizes & 0xFFFF,
        sequence=sequence,
        flags=flags & 0xFF,
        sectors=sizes >> 16 & 0xF,
        occlusion=occlusion,
        corner=corner,
        flat=flat,
    )


def _octets(vaddr: int, nbytes: int) -> np.ndarray:
    return np.ctypeslib.as_array((ctypes.c_uint8 * nbytes).from_address(vaddr))


def _power_of_two(value: int) -> int:
    return 1 << (value - 1).bit_length()
