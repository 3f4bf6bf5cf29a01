from __future__ import annotations

import numpy as np
import pytest

from fpga_overlay.cosim.dma_registers import (
    ADDRESS,
    CONTROL,
    DECODE_ERROR,
    DONE_IRQ,
    HALTED,
    IDLE,
    INTERNAL_ERROR,
    LENGTH,
    RECEIVE,
    RESET,
    RUN,
    STATUS,
    DmaRegisters,
)


class Echo:
    """Answers a packet with itself; memory of 4 kB at address 0."""

    def __init__(self) -> None:
        self.memory = np.arange(4096, dtype=np.uint16).astype(np.uint8)
        self.resets = 0

    def answer(self, beats: np.ndarray) -> list[np.ndarray]:
        return [beats]

    def reset(self) -> None:
        self.resets += 1

    def close(self) -> None:
        pass

    def window(self, address: int, nbytes: int) -> np.ndarray | None:
        return self.memory[address : address + nbytes] if address + nbytes <= len(self.memory) else None


@pytest.fixture
def echo() -> Echo:
    return Echo()


@pytest.fixture
def dma(echo: Echo) -> DmaRegisters:
    return DmaRegisters(echo, echo)


def start(dma: DmaRegisters, channel: int, address: int, length: int) -> None:
    dma.write(channel + CONTROL, RUN)
    dma.write(channel + ADDRESS, address)
    dma.write(channel + LENGTH, length)


def test_after_reset_both_channels_are_halted_and_the_bit_has_cleared_itself(dma: DmaRegisters, echo: Echo) -> None:
    start(dma, 0, 0, 64)
    dma.write(RECEIVE + CONTROL, RESET)
    for channel in (0, RECEIVE):
        assert dma.read(channel + STATUS) == HALTED
        assert dma.read(channel + CONTROL) == 0x10002
    assert echo.resets == 1


def test_a_packet_is_sent_when_somebody_receives_and_both_sides_are_then_idle(dma: DmaRegisters, echo: Echo) -> None:
    start(dma, 0, 0, 64)
    assert not dma.read(STATUS) & IDLE
    start(dma, RECEIVE, 1024, 128)
    for channel in (0, RECEIVE):
        assert dma.read(channel + STATUS) == IDLE | DONE_IRQ
        assert dma.read(channel + LENGTH) == 64
    np.testing.assert_array_equal(echo.memory[1024:1088], echo.memory[:64])
    dma.write(RECEIVE + STATUS, DONE_IRQ)
    assert dma.read(RECEIVE + STATUS) == IDLE


def test_a_halted_channel_and_a_length_of_nothing_start_nothing(dma: DmaRegisters) -> None:
    dma.write(LENGTH, 64)
    assert not dma.send.busy
    dma.write(CONTROL, RUN)
    dma.write(LENGTH, 0)
    assert not dma.send.busy


def test_a_length_has_26_bits(dma: DmaRegisters) -> None:
    start(dma, RECEIVE, 0, 1 << 26 | 64)
    assert dma.read(RECEIVE + LENGTH) == 64


def test_an_answer_longer_than_its_buffer_halts_the_receiver_with_an_error(dma: DmaRegisters) -> None:
    start(dma, RECEIVE, 1024, 48)
    start(dma, 0, 0, 64)
    assert dma.read(RECEIVE + STATUS) == INTERNAL_ERROR | HALTED


@pytest.mark.parametrize("channel", [0, RECEIVE])
def test_an_address_without_memory_halts_its_channel_with_an_error(dma: DmaRegisters, channel: int) -> None:
    start(dma, RECEIVE, 4096 if channel else 1024, 64)
    start(dma, 0, 1024 if channel else 4096, 64)
    assert dma.read(channel + STATUS) & (DECODE_ERROR | HALTED) == DECODE_ERROR | HALTED
