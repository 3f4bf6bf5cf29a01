"""report.html: one file that needs no other."""

from __future__ import annotations

from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Any

import numpy as np

from splitslam import __version__
from splitslam.ply import read_points
from splitslam.report import plots
from splitslam.report.map_view import draw_map, top_view
from splitslam.report.style import image, png, styled, svg
from splitslam.report.summary import key_figures

if TYPE_CHECKING:
    from splitslam.run.orchestrate import Run

_TABLES = (("edge CPU", "edge_ms"), ("edge wall", "edge_wall_ms"), ("map CPU", "map_ms"), ("map wall", "map_wall_ms"))
_MAP_WIDTH_IN = 11.0


def write_page(run: Run, path: Path) -> None:
    """Draw everything and write the page."""
    with styled():
        values = {
            "title": escape(run.title),
            "subtitle": escape(_subtitle(run.report)),
            "cards": "\n".join(_card(name, value) for name, value in _cards(run.report)),
            "map": image(_map(run), "The map from above with the trajectory over it"),
            "plots": "\n".join(f"<section>{svg(drawn)}</section>" for drawn in _plots(run)),
            "figures": "\n".join(_row(name, value) for name, value in key_figures(run.report)),
            "times": "\n".join(_time_rows(run.report)),
            "version": escape(__version__),
            "session": escape(run.report["session_id"]),
        }
    template = Template(files("splitslam.report").joinpath("page.html").read_text(encoding="utf-8"))
    path.write_text(template.substitute(values), encoding="utf-8")


def _map(run: Run) -> bytes:
    view = top_view(read_points(run.ply), run.trajectory.positions_m)
    xmin, xmax, ymin, ymax = view.extent_m
    height_in = min(max(_MAP_WIDTH_IN * 0.86 * (ymax - ymin) / (xmax - xmin), 3.5), 10.0)
    drawn, axes = plots.figure(_MAP_WIDTH_IN, height_in)
    draw_map(axes, view, run.trajectory, np.array(run.keyframes_map).reshape(-1, 3), run.loops)
    return png(drawn, dpi=150)


def _plots(run: Run) -> list[Any]:
    first = (plots.draw_height, plots.draw_speed)
    if run.truth is not None:
        first = (plots.draw_against_truth, plots.draw_errors)
    drawn = []
    for draw in (*first, plots.draw_bytes, plots.draw_latency, plots.draw_stages, plots.draw_corrections):
        made, axes = plots.figure(5.6, 3.5)
        draw(axes, run)
        drawn.append(made)
    return drawn


def _subtitle(report: dict[str, Any]) -> str:
    mapped = "{mapped} of {read} scans mapped".format_map(report["scans"])
    return f"{mapped} over {report['path_m']:.1f} m and {report['recording_s']:.1f} s"


def _cards(report: dict[str, Any]) -> list[tuple[str, str]]:
    uplink, score = report["uplink"], report.get("evaluation")
    cards = [] if not score else [("ATE of the final trajectory", f"{1e3 * score['trajectory']['ate_m']:.0f} mm")]
    if uplink["kbps"] is not None:
        cards.append(("uplink", f"{uplink['kbps']:,.0f} kbit/s"))
    if uplink["ratio_to_raw"] is not None:
        cards.append(("less than the raw data", f"{uplink['ratio_to_raw']:.0f}×"))
    if report["round_trip_ms"]:
        cards.append(("frame to answer, median", f"{report['round_trip_ms']['p50']:.0f} ms"))
    return [
        *cards,
        ("edge CPU a scan", f"{report['edge_ms']['total']['mean']:.1f} ms"),
        ("loop closures", str(report["loops"])),
    ]


def _card(name: str, value: str) -> str:
    return f'<div class="card"><b>{escape(value)}</b><span>{escape(name)}</span></div>'


def _row(name: str, *values: str) -> str:
    return f"<tr><td>{escape(name)}</td>" + "".join(f"<td>{escape(value)}</td>" for value in values) + "</tr>"


def _time_rows(report: dict[str, Any]) -> list[str]:
    rows = [(f"{name}: {stage}", times) for name, key in _TABLES for stage, times in report[key].items()]
    rows.append(("frame to answer", report["round_trip_ms"]))
    names = ("mean", "std", "p50", "p99", "max")
    return [_row(name, *(f"{times[column]:.2f}" for column in names)) for name, times in rows if times]
