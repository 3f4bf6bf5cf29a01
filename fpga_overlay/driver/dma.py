"""One packet there and one back through the AXI DMA, by PYNQ's own driver, with a time-out."""

from __future__ import annotations

import asyncio
import contextlib
import importlib
import time
import warnings
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from fpga_overlay.driver.errors import AcceleratorError
from fpga_overlay.golden.packet import Beats
from splitslam.errors import InputError

INSTANCE = "axi_dma_0"  # of the block design
BEAT_BYTES = 16
TIMEOUT_S = 0.020
_NAP_S = 50e-6
_CONTROL, _RESET = 0x00, 0x4  # AXI DMA, PG021: MM2S_DMACR, its reset bit resets both channels
_STATUS = {0x04: "sending", 0x34: "receiving"}  # MM2S_DMASR, S2MM_DMASR
_ERRORS = {
    0x10: "internal error (an answer longer than its buffer)",
    0x20: "slave error (memory refused)",
    0x40: "decode error (no memory there)",
}
_ANY_ERROR = sum(_ERRORS)


def import_pynq() -> ModuleType:
    """PYNQ, which is no dependency: the board's image brings it. InputError where it is not."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # it still uses pkg_resources
            importlib.import_module("pynq.lib.dma")
            return importlib.import_module("pynq")
    except ImportError as error:
        raise InputError(f"deskew fpga: PYNQ is not here ({error}); expected the board's image") from None


def load_overlay(bitstream: str, device: Any = None) -> Any:
    """PYNQ's Overlay of that bitstream, its .hwh beside it, loaded. InputError says why it is not."""
    pynq = import_pynq()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # no devices: the error that follows says it
            overlay = pynq.Overlay(bitstream, device=device)
        getattr(overlay, INSTANCE)
    except Exception as error:  # OSError, RuntimeError, KeyError, AttributeError: whatever the image's layers raise
        text = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"deskew fpga: {Path(bitstream).name} cannot be loaded: {text}") from None
    return overlay


class DmaLink:
    """The send and the receive buffer and the two channels between them and the logic."""

    def __init__(self, overlay: Any, longest_beats: int, timeout_s: float = TIMEOUT_S) -> None:
        """longest_beats: of any packet. InputError where the design's length register is too short for that."""
        self._pynq = import_pynq()
        self._loop = asyncio.new_event_loop()
        asyncio.set_event_loop(self._loop)  # where PYNQ hangs the interrupt's file on
        self._device, self._dma = overlay.device, getattr(overlay, INSTANCE)
        asyncio.set_event_loop(None)
        if longest_beats * BEAT_BYTES > self._dma.buffer_max_size:
            self._loop.close()
            raise InputError(
                f"deskew fpga: the DMA's length register holds {self._dma.buffer_max_size} bytes, "
                f"expected {longest_beats * BEAT_BYTES} (c_sg_length_width 26)"
            )
        self._wired = getattr(self._dma, "s2mm_introut", None) is not None
        self._timeout_s = timeout_s
        self._sound = True
        self._sent = self._received = None

    def reserve(self, send_beats: int, receive_beats: int) -> None:
        """Buffers for packets of that length; all of a buffer is flushed for each packet, so they are not larger."""
        if self._sent is None or len(self._sent) < send_beats:
            self._sent = self._allocate(send_beats)
            self.request: Beats = self._sent.view(np.ndarray)  # PYNQ's subclass is slow to slice
        if self._received is None or len(self._received) < receive_beats:
            self._received = self._allocate(receive_beats)
            self._answer: Beats = self._received.view(np.ndarray)

    def exchange(self, send_beats: int, receive_beats: int) -> Beats:
        """Sends the first beats of `request`; the answer, (B, 4) uint32, a view that the next one overwrites.

        AcceleratorError: `timeout`, `dma`.
        """
        if not self._sound:
            self.reset()
        self._start(self._dma.recvchannel, self._received, receive_beats)  # first: the answer begins at once
        self._start(self._dma.sendchannel, self._sent, send_beats)
        self._deadline = time.perf_counter() + self._timeout_s
        return self._finish()

    def receive(self, receive_beats: int) -> Beats:
        """Another answer to what was sent, within its time."""
        self._start(self._dma.recvchannel, self._received, receive_beats)
        return self._finish()

    def finish_sending(self) -> None:
        """Waits for what the answer did not wait for. AcceleratorError: as exchange."""
        self._wait(self._dma.sendchannel, "sending")

    def reset(self) -> None:
        """Ends what is under way, on both channels. AcceleratorError (`dma`): the engine does not come back."""
        self._sound = False
        self._dma.mmio.write(_CONTROL, _RESET)
        deadline = time.perf_counter() + self._timeout_s
        while self._dma.mmio.read(_CONTROL) & _RESET:
            if time.perf_counter() > deadline:
                raise AcceleratorError("dma", "it does not come out of reset")
        self._dma.sendchannel.start()
        self._dma.recvchannel.start()
        self._sound = True

    def reset_if_it_can(self) -> None:
        """After an error; if the engine does not come back now, the next exchange tries again."""
        with contextlib.suppress(AcceleratorError):
            self.reset()

    def close(self) -> None:
        """Gives the buffers back."""
        self._sent = self._received = None
        self._loop.close()

    def _allocate(self, beats: int) -> Any:
        return self._pynq.allocate((beats, 4), np.uint32, target=self._device, cacheable=1)

    def _start(self, channel: Any, buffer: Any, beats: int) -> None:
        try:
            channel.transfer(buffer, nbytes=beats * BEAT_BYTES)  # flushes what is sent
        except (RuntimeError, ValueError) as error:
            raise AcceleratorError("dma", str(error)) from None

    def _finish(self) -> Beats:
        channel = self._dma.recvchannel
        if self._wired and not _loop_is_running():
            with contextlib.suppress(TimeoutError):
                remaining = max(0.0, self._deadline - time.perf_counter())
                self._loop.run_until_complete(asyncio.wait_for(channel.wait_async(), remaining))
        self._wait(channel, "receiving")
        self._check()
        if channel._active_buffer is not None:  # else wait_async has done it
            channel.wait()  # invalidates what was received
        beats, rest = divmod(channel.transferred, BEAT_BYTES)
        if rest:
            raise AcceleratorError("answer", f"{channel.transferred} bytes, expected whole beats")
        return self._answer[:beats]

    def _wait(self, channel: Any, what: str) -> None:
        while not channel.idle:
            self._check()
            if time.perf_counter() > self._deadline:
                raise AcceleratorError("timeout", f"{what}, after {self._timeout_s * 1e3:.0f} ms")
            time.sleep(_NAP_S)

    def _check(self) -> None:
        """An error of either channel halts it, and the other one waits for ever."""
        for offset, what in _STATUS.items():
            status = self._dma.mmio.read(offset) & _ANY_ERROR
            if status:
                error = next(error for bit, error in _ERRORS.items() if status & bit)
                raise AcceleratorError("dma", f"{what}: {error}")


def _loop_is_running() -> bool:
    """Whether this thread is an event loop's, in which no other can run."""
    try:
        asyncio.get_running_loop()
    except RuntimeError:
        return False
    return True
