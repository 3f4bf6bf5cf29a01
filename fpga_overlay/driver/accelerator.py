"""The Image node's work and the Feature node's first half in programmable logic: one packet a scan, one back."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from pathlib import Path

from edge_agent.features.integer import MOST_SECTORS, Limits
from fpga_overlay.driver.answer import AcceleratedImage, AnswerReader, is_stale, most_beats
from fpga_overlay.driver.dma import TIMEOUT_S, DmaLink, load_overlay
from fpga_overlay.driver.errors import AcceleratorError
from fpga_overlay.driver.request import ROOM_BEATS, Request, RequestWriter
from fpga_overlay.driver.self_test import first_difference, made_knots, made_scan
from fpga_overlay.golden.packet import BYPASS_FEATURES, MAX_COLUMNS, MAX_POINTS, MAX_RINGS, Beats
from splitslam.errors import InputError
from splitslam.features import Knots
from splitslam.scan import Scan

BITSTREAM = "splitslam.bit"  # PYNQ looks for it here and among its overlays


class Accelerator:
    """A self-tested overlay. One caller at a time."""

    def __init__(self, link: DmaLink, rings: int, columns: int, limits: Limits, features: bool = True) -> None:
        """features: False leaves ordering and marks to this processor. See `open`."""
        self.counts: Counter[str] = Counter()  # stale: answers that came too late; resets
        self._link, self._cells = link, rings * columns
        self._records = self._cells if features else 0  # at most, in an answer
        self._writer = RequestWriter(rings, columns, limits, 0 if features else BYPASS_FEATURES)
        self._reader = AnswerReader(rings, columns, limits)
        self._rings, self._columns = rings, columns
        self._sequence = 0
        self._closing: Callable[[], None] = lambda: None

    @classmethod
    def open(cls, rings: int, columns: int, limits: Limits, bitstream: Path | None = None) -> Accelerator:
        """Loads the bitstream (None: `splitslam.bit`) on this board and tests it.

        InputError: a sensor or thresholds that the logic cannot hold, no PYNQ, no board, no bitstream, or a self-test
        that failed; the text says which.
        """
        check_fits(rings, columns, limits)
        overlay = load_overlay(str(bitstream or BITSTREAM))
        return cls._tested(cls(DmaLink(overlay, _longest()), rings, columns, limits))

    @classmethod
    def open_cosim(cls, rings: int, columns: int, limits: Limits) -> Accelerator:
        """The same driver over the cores on Verilator, behind PYNQ's device interface. InputError: cannot be built."""
        check_fits(rings, columns, limits)
        try:
            from fpga_overlay.cosim.device import CosimDevice, VerilatedLogic
        except ImportError as error:
            raise InputError(f"deskew cosim: it needs a checkout of the repository ({error})") from None
        return cls.on_device(CosimDevice(VerilatedLogic(rings, columns)), rings, columns, limits)

    @classmethod
    def on_device(cls, device, rings: int, columns: int, limits: Limits, **options) -> Accelerator:
        """Over any device of cosim.device, self-tested. options: features, timeout_s. InputError as `open`."""
        timeout_s = options.pop("timeout_s", TIMEOUT_S)
        link = DmaLink(load_overlay(str(device.bitstream), device), _longest(), timeout_s)
        made = cls(link, rings, columns, limits, **options)
        made._closing = device.close
        return cls._tested(made)

    def run(self, scan: Scan, knots: Knots) -> AcceleratedImage:
        """The scan's image with its points at the scan's reference time, and their marks.

        AcceleratorError: this scan was not done; the engine has been reset, and the next one may be tried.
        """
        return self._exchange(scan, knots)[2]

    def self_test(self) -> None:
        """One made scan to the bit. AcceleratorError (`self_test`, or as `run`): what differs."""
        request, answer, _ = self._exchange(made_scan(self._rings), made_knots())
        if different := first_difference(request, answer):
            raise AcceleratorError("self_test", different)

    def close(self) -> None:
        """Gives the buffers back; nothing else may follow."""
        self._link.close()
        self._closing()

    @staticmethod
    def _tested(made: Accelerator) -> Accelerator:
        try:
            made.self_test()
        except AcceleratorError as error:
            made.close()
            raise InputError(f"deskew fpga: the self-test failed: {error}") from None
        return made

    def _exchange(self, scan: Scan, knots: Knots) -> tuple[Request, Beats, AcceleratedImage]:
        if len(scan) > MAX_POINTS:
            raise AcceleratorError("size", f"{len(scan)} points, expected at most {MAX_POINTS}")
        count = max(len(scan), self._cells)
        self._link.reserve(ROOM_BEATS + count, most_beats(count, self._records))
        self._sequence = (self._sequence + 1) % 2**32
        request = self._writer.write(scan, knots, self._sequence, self._link.request)
        try:
            answer = self._answer(len(request.beats), most_beats(len(scan), self._records))
            return request, answer, self._reader.read(answer, request.header, len(scan))
        except AcceleratorError:
            self.counts["resets"] += 1
            self._link.reset_if_it_can()
            raise

    def _answer(self, send_beats: int, receive_beats: int) -> Beats:
        answer = self._link.exchange(send_beats, receive_beats)
        while is_stale(answer, self._sequence):
            self.counts["stale"] += 1
            answer = self._link.receive(receive_beats)
        self._link.finish_sending()
        return answer


def check_fits(rings: int, columns: int, limits: Limits) -> None:
    """InputError for a sensor or thresholds that the logic's widths cannot hold."""
    for value, most, what in (
        (rings, MAX_RINGS, "rings"),
        (columns, MAX_COLUMNS, "columns"),
        (limits.sectors, MOST_SECTORS, "sectors"),
        (limits.occlusion, (1 << 18) - 1, "occlusion threshold in 1/1024 m"),
        (limits.corner, (1 << 22) - 1, "corner threshold in 1/1024 m"),
        (limits.flat, (1 << 22) - 1, "flat threshold in 1/1024 m"),
    ):
        if not 1 <= value <= most:
            raise InputError(f"deskew fpga: {what}: {value}, expected 1 to {most}, which the logic holds")
    if columns % 2:
        raise InputError(f"deskew fpga: columns: {columns}, expected an even number, which the logic needs")


def _longest() -> int:
    return max(ROOM_BEATS + MAX_POINTS, most_beats(MAX_POINTS, MAX_RINGS * MAX_COLUMNS))
