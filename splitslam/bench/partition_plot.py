"""partition.png: what each cut sends, and Figure 12, beside the paper's."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from splitslam.bench import paper
from splitslam.bench.break_even import total_ms
from splitslam.bench.paper import A53_FACTOR
from splitslam.bench.partition_result import BANDWIDTHS_MBPS, CASES, Partition
from splitslam.report.style import BLUE, GREEN, INK, MUTED, ORANGE, TRUTH, png, styled

_COLOURS = {"case1": MUTED, "case2": GREEN, "case3": ORANGE, "ours": BLUE}
_SCAN_MS = 1e3 / paper.SCAN_HZ
_NAMES = {"case1": "Case 1: raw", "case2": "Case 2: deskewed", "case3": "Case 3: LIO-SAM's features", "ours": "ours"}


def draw(found: list[Partition]) -> bytes:
    """A PNG, one row a recording: rates on the left, time against bandwidth on this CPU and as predicted for an A53."""
    with styled():
        figure = Figure(figsize=(15.0, 4.4 * len(found)), layout="constrained")
        grid = figure.subplots(len(found), 3, squeeze=False, width_ratios=(1.0, 1.1, 1.1))
        for one, (rates, here, a53) in zip(found, grid, strict=True):
            draw_rates(rates, one)
            draw_times(here, one, 1.0, f"{one.name}: edge on this CPU (measured)")
            draw_times(a53, one, A53_FACTOR, f"{one.name}: edge on an A53 (predicted: {A53_FACTOR:g} x)")
            draw_paper_times(a53)
            a53.legend(loc="upper right")
            here.legend(loc="upper right")
        return png(figure, dpi=110)


def draw_rates(axes: Axes, one: Partition) -> None:
    """Mbit/s of each case, the paper's Table III and the two harder yardsticks as marks."""
    rows: list[tuple[str, float, str]] = [(_NAMES[case], one.total_mbps(case), _COLOURS[case]) for case in CASES]
    for name, size in (("native packets", one.native_bytes), ("LAZ at 1 cm", one.laz_bytes)):
        if size is not None:
            rows.append((name, one.mbps(size), TRUTH))
    at = np.arange(len(rows))[::-1]
    axes.barh(at, [mbps for _, mbps, _ in rows], height=0.6, color=[colour for *_, colour in rows])
    for y, (_, mbps, _) in zip(at, rows, strict=True):
        axes.annotate(f"{mbps:.3g}", (mbps, y), (4, 0), textcoords="offset points", va="center", color=INK)
    paper_mbps = [sum(paper.TABLE_3[case]) for case in CASES if case in paper.TABLE_3]
    axes.plot(paper_mbps, at[: len(paper_mbps)] - 0.38, "^", color=INK, ms=5, label="the paper, Table III")
    axes.set_yticks(at, [name for name, *_ in rows])
    axes.tick_params("y", length=0, labelcolor=INK)
    axes.set_xscale("log")
    axes.set_xlim(0.5 * min(mbps for _, mbps, _ in rows), 3.0 * max(mbps for _, mbps, _ in rows))
    axes.xaxis.set_major_formatter("{x:g}")
    axes.grid(axis="y", visible=False)
    axes.set(xlabel="Mbit/s", title=f"{one.name}: uplink")
    axes.legend(loc="lower right")


def draw_times(axes: Axes, one: Partition, edge_factor: float, title: str) -> None:
    """Figure 12 of a recording; break-evens with Case 1 as dots."""
    case1 = one.cases["case1"].cut(edge_factor)
    for name in CASES:
        cut = one.cases[name].cut(edge_factor)
        axes.plot(BANDWIDTHS_MBPS, total_ms(cut, BANDWIDTHS_MBPS), color=_COLOURS[name], lw=1.8, label=_NAMES[name])
        even = one.break_even_mbps(name, edge_factor)
        if name != "case1" and 0.0 < even <= BANDWIDTHS_MBPS[-1]:
            y_ms = case1.time_ms + case1.kbit / even
            axes.plot([even], [y_ms], "o", color=_COLOURS[name], ms=5)
            text = f"{even:.0f} Mbit/s"
            axes.annotate(text, (even, y_ms), (-6, -11), textcoords="offset points", ha="right", color=_COLOURS[name])
    axes.set_xscale("log")
    axes.set_yscale("log")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter("{x:g}")
    axes.set_xlim(BANDWIDTHS_MBPS[0], BANDWIDTHS_MBPS[-1])
    axes.axhline(_SCAN_MS, color=INK, lw=0.7, ls=":")
    at = (BANDWIDTHS_MBPS[-1], _SCAN_MS)
    axes.annotate("a scan at 10 Hz", at, (-3, 3), textcoords="offset points", ha="right", fontsize=7)
    axes.set(xlabel="bandwidth (Mbit/s)", ylabel="edge + server + link (ms a scan)", title=title)


def draw_paper_times(axes: Axes) -> None:
    """The paper's own Figure 12, from its Tables III and VI, Walking."""
    styles = {"case1": "-", "case3": "--", "case3_fpga": ":"}
    names = {"case1": "Case 1", "case3": "Case 3", "case3_fpga": "Case 3, FPGA"}
    for name, cut in paper.CUTS.items():
        label = f"the paper: {names[name]}"
        axes.plot(BANDWIDTHS_MBPS, total_ms(cut, BANDWIDTHS_MBPS), styles[name], color=INK, lw=0.9, label=label)
