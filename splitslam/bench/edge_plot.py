"""edge.png: Figures 10 and 11, a row a recording, beside the paper's Walking figures."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from splitslam.bench import paper
from splitslam.bench.edge_result import SCAN_MS, EdgeTimes
from splitslam.bench.paper import A53_FACTOR
from splitslam.report.style import BLUE, INK, LIGHT_BLUE, ORANGE, png, styled

# As in the paper: orange with FPGA, blue without.
_PLAIN, _FAST = "software", "with FPGA"
_BINS = 40


def draw(found: list[EdgeTimes]) -> bytes:
    """A PNG."""
    with styled():
        figure = Figure(figsize=(18.0, 3.7 * len(found)), layout="constrained")
        grid = figure.subplots(len(found), 4, squeeze=False, width_ratios=(1.3, 1.3, 1.1, 1.0))
        for one, (here, a53, bars, histogram) in zip(found, grid, strict=True):
            draw_scans(here, one, "here", f"{one.name}: edge on this CPU (measured)")
            draw_scans(a53, one, "a53", f"{one.name}: edge on an A53 (predicted: {A53_FACTOR:g} x)")
            draw_bars(bars, one)
            draw_histogram(histogram, one)
        return png(figure, dpi=110)


def draw_scans(axes: Axes, one: EdgeTimes, how: str, title: str) -> None:
    """Figure 10: every scan. With FPGA: the RTL's clocks at 100 MHz and the processor's share."""
    by = one.series()["edge"]
    plain, fast = by[how], by[f"{how}_fpga"]
    assert plain is not None
    scan = np.arange(1, one.scans + 1)
    axes.bar(scan, plain, width=1.0, color=LIGHT_BLUE if fast is not None else BLUE, label=_PLAIN)
    most = float(plain.max())
    if fast is not None:
        axes.step(np.arange(1, len(fast) + 1), fast, where="mid", color=ORANGE, lw=1.4, label=_FAST)
        most = max(most, float(fast.max()))
    if 1.25 * most > SCAN_MS:
        _scan_line(axes, one.scans + 0.5, "right")
    axes.set_xlim(0.5, one.scans + 0.5)
    axes.set_ylim(0.0, 1.25 * most)
    axes.grid(axis="x", visible=False)
    axes.set(xlabel="scan", ylabel="ms a scan", title=title)
    axes.legend(loc="upper left", ncols=2)


def draw_bars(axes: Axes, one: EdgeTimes) -> None:
    """Figure 11: mean and, paler, maximum; here, on an A53 by prediction, and the paper's Walking on its board."""
    by = one.series()["edge"]
    mean, mean_fpga, most, most_fpga = paper.TABLE_6["Walking"]
    rows: list[tuple[str, tuple[float, float], tuple[float, float] | None]] = [
        ("this CPU,\nmeasured", _mean_max(by["here"]) or (0.0, 0.0), _mean_max(by["here_fpga"])),
        ("A53,\npredicted", _mean_max(by["a53"]) or (0.0, 0.0), _mean_max(by["a53_fpga"])),
        ("the paper,\n16x1800", (mean, most), (mean_fpga, most_fpga)),
    ]
    for at, (_, plain, fast) in enumerate(rows):
        for offset, values, colour in ((-0.2, plain, BLUE), (0.2, fast, ORANGE)):
            if values is None:
                continue
            axes.bar(at + offset, values[1], width=0.36, color=colour, alpha=0.35)
            axes.bar(at + offset, values[0], width=0.36, color=colour)
            for value in values:
                text = f"{value:.3g}"
                axes.annotate(text, (at + offset, value), (0, 2), textcoords="offset points", ha="center", fontsize=7)
    _scan_line(axes, -0.45, "left")
    axes.set_xticks(range(len(rows)), [name for name, *_ in rows])
    axes.tick_params("x", length=0, labelcolor=INK)
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter("{x:g}")
    axes.set_ylim(0.5, 2.5 * max(max(plain[1], most) for _, plain, _ in rows))
    axes.grid(axis="x", visible=False)
    axes.set(ylabel="ms a scan", title=f"{one.name}: mean and maximum")


def draw_histogram(axes: Axes, one: EdgeTimes) -> None:
    """How the scans' times are spread, on this processor."""
    by = one.series()["edge"]
    plain, fast = by["here"], by["here_fpga"]
    assert plain is not None
    shown = [(plain, LIGHT_BLUE, BLUE, _PLAIN)]
    if fast is not None:
        shown.append((fast, "none", ORANGE, _FAST))
    all_ms = np.concatenate([ms for ms, *_ in shown])
    bins = np.linspace(0.95 * float(all_ms.min()), 1.02 * float(all_ms.max()), _BINS + 1)
    for ms, face, edge, label in shown:
        axes.hist(ms, bins=bins.tolist(), histtype="stepfilled", facecolor=face, edgecolor=edge, lw=1.4, label=label)
    axes.grid(axis="x", visible=False)
    axes.set(xlabel="ms a scan, this CPU", ylabel="scans", title=f"{one.name}: histogram, this CPU")
    axes.legend(loc="upper right")


def _mean_max(ms: NDArray[np.float64] | None) -> tuple[float, float] | None:
    return None if ms is None else (float(ms.mean()), float(ms.max()))


def _scan_line(axes: Axes, x: float, side: str) -> None:
    axes.axhline(SCAN_MS, color=INK, lw=0.7, ls=":")
    axes.annotate("a scan at 10 Hz", (x, SCAN_MS), (0, 3), textcoords="offset points", ha=side, fontsize=7)
