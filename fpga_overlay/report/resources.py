"""What the cores take of the device: Yosys synthesis, not placed and routed."""

from __future__ import annotations

from dataclasses import asdict

from fpga_overlay.syn.yosys import synthesise


def resources() -> dict[str, dict[str, float]]:
    """dsp, bram36, uram, lut and ff of `deskew`, `features` and `total` (both, chained), in the board's size."""
    return {
        "deskew": asdict(synthesise("deskew_core")),
        "features": asdict(synthesise("feature_core")),
        "total": asdict(synthesise("splitslam_top")),
    }
