"""What the cores take of the device: Yosys synthesis, not placed and routed."""

from __future__ import annotations


def resources() -> dict[str, dict[str, float]]:
    """dsp, bram36, uram, lut and ff of `deskew`, `features` and `total`, counted afresh."""
    raise NotImplementedError
