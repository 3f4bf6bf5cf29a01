"""The look of all pictures, and how they get into a page."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib
from matplotlib.figure import Figure

INK = "#1f2933"
MUTED = "#7b8794"
BLUE = "#1565c0"
ORANGE = "#e06c00"
GREEN = "#2e7d32"
LIGHT_BLUE = "#90caf9"
TRUTH = "#9aa5b1"

_RC: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": "#cbd2d9",
    "axes.titlesize": 10,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e4e7eb",
    "grid.linewidth": 0.7,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "legend.frameon": False,
    "legend.fontsize": 8,
    "svg.hashsalt": "splitslam",  # the same run gives the same file
}


@contextmanager
def styled() -> Iterator[None]:
    """Everything drawn and saved inside has the look."""
    with matplotlib.rc_context(_RC):
        yield


def svg(figure: Figure) -> str:
    """An inline <svg>, as wide as its place."""
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", bbox_inches="tight", metadata={"Date": None, "Creator": None}, dpi=150)
    text = buffer.getvalue()
    return text[text.index("<svg") :]


def png(figure: Figure, dpi: int = 200) -> bytes:
    """A PNG file."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", bbox_inches="tight", dpi=dpi, facecolor="white", metadata={"Software": None})
    return buffer.getvalue()


def image(data: bytes, text: str) -> str:
    """An <img> with the PNG inside; `text` is read out to those who do not see it."""
    return f'<img alt="{text}" src="data:image/png;base64,{base64.b64encode(data).decode("ascii")}">'
