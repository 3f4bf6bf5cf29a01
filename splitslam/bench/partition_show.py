"""The partition experiment on the terminal, within 100 columns."""

from __future__ import annotations

import math

from rich.console import Console
from rich.table import Table

from splitslam.bench import laz, paper
from splitslam.bench.figures_table import figures_table
from splitslam.bench.paper import A53_FACTOR
from splitslam.bench.partition_result import CASES, Partition

TITLES = {
    "case1": "Case 1, raw points and IMU",
    "case2": "Case 2, deskewed cloud",
    "case3": "Case 3, LIO-SAM's features",
    "ours": "ours, everything in TCP",
}
_AT_MBPS = (5.0, 20.0, 100.0)
_HERE, _A53 = "edge here, measured", "A53: predicted, not measured"
_NOTES = (
    f"Times: mean CPU. A53: {A53_FACTOR:g} times this CPU's on the edge, assumed, not measured. Server: this CPU, what",
    "Case 3 and ours do on the edge, or decoding. Break-even: with Case 1; always: less to send, no more",
    "time. LAZ: every scan, points only. Ours: both programs; the rest: both pipelines in one process.",
)
_NONE = "-"
_WIDTH = 100


def show(found: list[Partition], laz_missing: bool, console: Console | None = None) -> None:
    """Tables III and IV of each recording, its Figure 12 in numbers, and the check against the paper's own."""
    console = console or Console(highlight=False)
    if not console.is_terminal:
        console.width = _WIDTH
    for one in found:
        console.print(_bytes(one))
        console.print(_ros(one), style="dim")
        console.print()
        console.print(_times(one))
        console.print(f"Slowest scan of ours on the edge, this CPU: {one.edge_max_ms:.1f} ms.\n", style="dim")
    console.print(_paper())
    console.print()
    for line in (*_NOTES, *([laz.MISSING] if laz_missing else [])):
        console.print(line, style="dim", markup=False)
    made = paper.check()
    ours, theirs = (" and ".join(f"{mbps[name]:.2f}" for name in made) for mbps in (made, paper.BREAK_EVEN_MBPS))
    console.print(f"check: the paper's inputs break even at {ours} Mbit/s (the paper: {theirs})")


def _bytes(one: Partition) -> Table:
    title = f"{one.name}: {one.scans} scans in {one.recording_s:.1f} s, {one.points:,.0f} points a scan"
    columns = ("points\nMbit/s", "IMU\nMbit/s", "total\nMbit/s", "Case 1\nto this", "native\nto this", "LAZ\nto this")
    table = figures_table(title, "\nwhat is sent", *columns)
    yardsticks = (one.case1_bytes, one.native_bytes, one.laz_bytes)
    for name in CASES:
        case = one.cases[name]
        ratios = [_ratio(one.ratio(name, to)) for to in yardsticks]
        rates = [_rate(one.mbps(size)) for size in (case.bytes, case.imu_bytes, case.bytes + case.imu_bytes)]
        table.add_row(TITLES[name], *rates, *ratios, style="bold" if name == "ours" else None)
    for what, size in (("the sensor's native packets", one.native_bytes), ("LAZ, whole scan, 1 cm", one.laz_bytes)):
        if size is None:
            table.add_row(what, *[_NONE] * 6, style="dim")
        else:
            rate = _rate(one.mbps(size))
            table.add_row(what, rate, _NONE, rate, *(_ratio(to and to / size) for to in yardsticks), style="dim")
    return table


def _ros(one: Partition) -> str:
    rates = " and ".join(f"{one.mbps(one.ros_bytes[name]):.1f}" for name in ("case2", "case3"))
    return f"Above: what the fields hold. LIO-SAM's messages as ROS serialises them: {rates} Mbit/s."


def _times(one: Partition) -> Table:
    """Figure 12 in numbers, for an edge that is this processor and for one that is predicted."""
    title = f"{one.name}: time of a scan, edge + server + link (Figure 12)"
    at = [f"ms at\n{mbps:g} Mbit/s" for mbps in _AT_MBPS]
    table = figures_table(title, "\n", "kbit\na scan", "edge\nms", "server\nms", *at, "break-even\nMbit/s")
    for where, factor in ((_HERE, 1.0), (_A53, A53_FACTOR)):
        table.add_row(where, style="underline")
        for name in CASES:
            case, cut = one.cases[name], one.cases[name].cut(factor)
            times = (factor * sum(case.edge_ms.values()), sum(case.server_ms.values()))
            totals = [f"{cut.time_ms + cut.kbit / mbps:.1f}" for mbps in _AT_MBPS]
            even = _NONE if name == "case1" else _even(one.break_even_mbps(name, factor))
            row = (TITLES[name], f"{cut.kbit:,.0f}", *(f"{ms:.1f}" for ms in times), *totals, even)
            table.add_row(*row, style="bold" if name == "ours" else None)
    return table


def _paper() -> Table:
    """Tables III and IV of the paper."""
    columns = ("points\nMbit/s", "IMU\nMbit/s", "total\nMbit/s", "Case 1\nto this")
    table = figures_table("The paper (Walking; Campus and Park: its Table IV)", "\nwhat is sent", *columns)
    whole = sum(paper.TABLE_3["case1"])
    for name, (points, imu) in paper.TABLE_3.items():
        total = points + imu
        table.add_row(TITLES[name], _rate(points), _rate(imu), _rate(total), _ratio(whole / total))
    for name, (mbps, share) in paper.TABLE_4.items():
        if name != "Walking":
            table.add_row(f"Case 3, {name}", _rate(mbps), _rate(0), _rate(mbps), _ratio(1 / share))
    return table


def _rate(mbps: float) -> str:
    return "0" if mbps == 0 else f"{mbps:.2f}" if mbps >= 1 else f"{mbps:.3f}"


def _ratio(value: float | None) -> str:
    return _NONE if value is None else f"{value:,.0f}" if value >= 100 else f"{value:.3g}"


def _even(mbps: float) -> str:
    return "always" if math.isinf(mbps) else "never" if mbps == 0 else f"{mbps:,.1f}" if mbps < 1e4 else f"{mbps:,.0f}"
