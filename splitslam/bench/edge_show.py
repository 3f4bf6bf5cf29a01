"""The edge's times on the terminal, within 100 columns: Tables V and VI, this machine above the paper."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from splitslam.bench import paper
from splitslam.bench.edge_result import SCAN_MS, STAGES, EdgeTimes, Stats
from splitslam.bench.figures_table import figures_table
from splitslam.bench.paper import A53_FACTOR

_WIDTH = 100
_NONE = "-"
_HERE, _A53 = "this CPU, measured", "A53: predicted, not measured"
_NOTES = (
    "Thread CPU time of each scan but the first. Deskew: the Image node, projection included. Edge:",
    "motion, deskew, features, encoding (the paper: Image and Feature node, the Imu node left out).",
    f"A53: {A53_FACTOR:g} times this CPU's time, assumed; with FPGA: by the model of fpga_overlay/report/board.py.",
)


def show(found: list[EdgeTimes], fpga: str, console: Console | None = None) -> None:
    """Tables V and VI, stages, and the bars. fpga: how the times with FPGA came about."""
    console = console or Console(highlight=False)
    if not console.is_terminal:
        console.width = _WIDTH
    console.print(_table_5(found))
    console.print()
    console.print(_table_6(found))
    console.print()
    console.print(_stages(found))
    console.print()
    for line in (*_NOTES, f"With FPGA: {fpga}."):
        console.print(line, style="dim", markup=False)
    for one in found:
        for line in _bars(one):
            console.print(line)


def _table_5(found: list[EdgeTimes]) -> Table:
    """Deskew."""
    columns = ("mean\nms", "std\nms", "maximum\nms", f"over\n{SCAN_MS:g} ms", "with FPGA\nms", "mean to\nFPGA")
    table = figures_table("Table V: deskew of a scan", "\n", *columns)
    for where, how in ((_HERE, "here"), (_A53, "a53")):
        table.add_row(where, style="underline")
        for one in found:
            by = one.series()["deskew"]
            plain, fast = _stats(by[how]), _stats(by[f"{how}_fpga"])
            assert plain is not None
            row = [_ms(plain.mean), _ms(plain.std), _ms(plain.max), f"{plain.over:.1%}"]
            row += [_NONE, _NONE] if fast is None else [_ms(fast.mean), f"{plain.mean / fast.mean:.2f}"]
            table.add_row(one.name, *row)
    table.add_row("the paper, on its board", style="underline")
    for name, (mean, std, most, fast_ms) in paper.TABLE_5.items():
        table.add_row(name, _ms(mean), _ms(std), _ms(most), _NONE, _ms(fast_ms), f"{mean / fast_ms:.2f}")
    return table


def _table_6(found: list[EdgeTimes]) -> Table:
    """The whole edge."""
    columns = ("mean\nms", "with\nFPGA", "std\nms", "with\nFPGA", "maximum\nms", "with\nFPGA")
    over = f"over {SCAN_MS:g} ms\nwithout, with"
    table = figures_table("Table VI: a scan on the edge", "\n", *columns, over, "mean to\nFPGA")
    for where, how in ((_HERE, "here"), (_A53, "a53")):
        table.add_row(where, style="underline")
        for one in found:
            by = one.series()["edge"]
            plain, fast = _stats(by[how]), _stats(by[f"{how}_fpga"])
            assert plain is not None
            pairs = [
                text
                for key in ("mean", "std", "max")
                for text in (_ms(getattr(plain, key)), _NONE if fast is None else _ms(getattr(fast, key)))
            ]
            shares = f"{plain.over:.1%}, " + (_NONE if fast is None else f"{fast.over:.1%}")
            table.add_row(one.name, *pairs, shares, _NONE if fast is None else f"{plain.mean / fast.mean:.2f}")
    table.add_row("the paper, on its board", style="underline")
    for name, (mean, mean_fpga, most, most_fpga) in paper.TABLE_6.items():
        texts = (_ms(mean), _ms(mean_fpga), _NONE, _NONE, _ms(most), _ms(most_fpga))
        table.add_row(name, *texts, "some, 0%", f"{mean / mean_fpga:.2f}")
    return table


def _stages(found: list[EdgeTimes]) -> Table:
    """Where the time goes here."""
    table = figures_table(
        "Stages, mean ms on this CPU", "\n", "points\na scan", *(f"\n{s}" for s in STAGES), "\ntotal", "\np99"
    )
    for one in found:
        rows = [(one.name, one.cpu_ms)]
        if one.accelerated is not None:
            rows.append(("  with FPGA, this CPU's share", one.accelerated.ps_ms))
        for name, ms in rows:
            means = (_ms(float(ms[stage].mean())) for stage in (*STAGES, "total"))
            table.add_row(name, f"{one.points:,.0f}", *means, _ms(Stats.of(ms["total"]).p99))
    return table


def _bars(one: EdgeTimes) -> list[str]:
    titles = {"cpu_mean_ms": "edge on this CPU", "ps_mean_ms": "this CPU's share with the cores"}
    lines = []
    for name, bar in one.bars().items():
        seen = "not measured" if bar["seen"] is None else f"{bar['seen']:.2f} ms, {'met' if bar['met'] else 'NOT met'}"
        lines.append(f"bar {one.lidar}: {titles[name]} <= {bar['bar']:g} ms mean: {seen}")
    return lines


def _stats(ms: NDArray[np.float64] | None) -> Stats | None:
    return None if ms is None else Stats.of(ms)


def _ms(value: float) -> str:
    return f"{value:.2f}" if value < 100 else f"{value:.0f}"
