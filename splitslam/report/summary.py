"""The key figures of a run, in words: for the terminal and the head of report.html."""

from __future__ import annotations

from pathlib import Path
from typing import Any


def key_figures(report: dict[str, Any]) -> list[tuple[str, str]]:
    """(what, value with unit) of report.json, the most wanted first."""
    scans, uplink, jumps = report["scans"], report["uplink"], report["jumps"]
    score = report.get("evaluation", {})
    figures = [
        ("scans mapped", f"{scans['mapped']} of {scans['read']} ({scans['dropped']} dropped)"),
        ("path", f"{report['path_m']:.1f} m in {report['recording_s']:.1f} s"),
    ]
    if score:
        figures += [
            ("ATE, final", _mm(score["trajectory"]["ate_m"])),
            ("ATE, online", _mm(score["online"]["ate_m"])),
            ("RPE over 1 s", _mm(score["trajectory"]["rpe_1s_m"])),
        ]
    dense = report.get("dense") or {"sent": 0, "waiting": 0}
    if dense["sent"] or dense["waiting"]:
        live = f"live uplink {_number(uplink['live_kbps'], 0)} kbit/s"
        figures.append(("dense keyframes", f"{dense['sent']} sent, {dense['waiting']} left; {live}"))
    return [
        *figures,
        ("uplink", f"{_number(uplink['kbps'], 0)} kbit/s, {_number(uplink['bytes_per_scan'], 0)} B a scan"),
        ("raw data", f"{_number(uplink['raw_kbps'], 0)} kbit/s, {_number(uplink['ratio_to_raw'], 1)} times as much"),
        ("edge CPU a scan", _times(report["edge_ms"].get("total"))),
        ("map CPU a scan", _times(report["map_ms"].get("total"))),
        ("frame to answer", _times(report["round_trip_ms"])),
        ("keyframes", str(report["keyframes"])),
        ("loop closures", str(report["loops"])),
        ("GNSS factors", str(report["gnss_factors"])),
        ("corrections of the map", f"{jumps['map_count']}, largest {_mm(jumps['map_max_m'])}"),
        ("run time", f"{_number(report['wall_s'], 1)} s"),
    ]


def show(report: dict[str, Any], out: Path) -> None:
    """A table on stdout, and where the results are."""
    from rich.console import Console
    from rich.table import Table

    table = Table(show_header=False, box=None, padding=(0, 2))
    for name, value in key_figures(report):
        table.add_row(name, value)
    console = Console(soft_wrap=True, highlight=False)
    console.print(table)
    for reason, count in sorted(report["dropped_by_reason"].items()):
        console.print(f"  dropped: {count} x {reason}", style="yellow", markup=False)
    if lost := report["lost_scans"]:
        hint = "`splitslam check` tells whether the robot file is wrong"
        console.print(f"  lost in {lost} scans: {hint}", style="yellow", markup=False)
    console.print(f"  {out / 'report.html'}", markup=False)


def _mm(value_m: float | None) -> str:
    return "run too short" if value_m is None else f"{1e3 * value_m:.0f} mm" if value_m < 1 else f"{value_m:.2f} m"


def _number(value: float | None, digits: int) -> str:
    return "unknown" if value is None else f"{value:,.{digits}f}"


def _times(times: dict[str, float] | None) -> str:
    return "unknown" if not times else f"{times['mean']:.1f} ms mean, {times['p99']:.1f} ms p99"
