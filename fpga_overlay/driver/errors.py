"""What can go wrong with one scan on the programmable logic."""

from __future__ import annotations


class AcceleratorError(Exception):
    """The logic did not do this scan; the next call may be tried all the same.

    reason, a short label to count by: `timeout`, `dma` (the engine reports an error, or does not reset), `answer` (what
    came back is none), `self_test` (nor was it then), `size` (more points than a packet holds), `motion` (beyond the
    fixed-point formats).
    """

    def __init__(self, reason: str, detail: str) -> None:
        super().__init__(f"accelerator: {reason}: {detail}")
        self.reason = reason
