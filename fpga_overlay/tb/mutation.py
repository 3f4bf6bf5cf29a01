"""A deliberate mistake in the RTL."""

from __future__ import annotations

import re
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Mutation:
    """In `file`, the text `old`, which occurs once, becomes `new`; cocotb test `test` of `bench` on `top` must fail."""

    name: str
    file: str
    old: str
    new: str
    test: str
    top: str = "deskew_core"
    bench: str = "fpga_overlay.tb.deskew_core"
    parameters: tuple[tuple[str, int], ...] = ()  # of `top`

    @property
    def only(self) -> str:
        """The test and no other one, all its parameters included."""
        return rf"\.{re.escape(self.test)}(/|$)"
