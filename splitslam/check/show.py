"""A check's report as tables for people and as JSON."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table
from rich.text import Text

from splitslam.check.findings import problems
from splitslam.check.mounting import Mounting
from splitslam.check.offline import Report
from splitslam.check.streams import StreamStatistics


def as_dict(report: Report) -> dict[str, Any]:
    """JSON-ready; docs/check.md says what each key means."""
    imu, place = report.imu, None if report.imu is None else report.imu.mounting
    return {
        "ok": not problems(report.findings),
        "recording": str(report.recording),
        "recorded_s": report.recorded_s,
        "findings": [finding.as_dict() for finding in report.findings],
        "streams": {name: asdict(s) for name, s in report.streams.items()},
        "lidar": _layout(report),
        "point_times": None if report.point_times is None else asdict(report.point_times),
        "imu": None if imu is None else {"gravity_mps2": imu.gravity_mps2, "up_lidar": _list(imu.up_lidar)},
        "T_lidar_imu": None if place is None else _rotation(place),
        "time_offset": None if place is None else _offset(place),
        "table_1": None if report.table is None else asdict(report.table),
    }


def _layout(report: Report) -> dict[str, Any]:
    seen = report.layout
    angles = [None if np.isnan(a) else round(float(np.degrees(a)), 3) for a in seen.elevations_rad]
    return {
        "rings_seen": seen.rings_seen,
        "columns": seen.columns,
        "min_range_m": seen.min_range_m,
        "max_range_m": seen.max_range_m,
        "span_s": seen.span_s,
        "nan_share": seen.nan_share,
        "beam_elevations_deg": angles,
    }


def _rotation(place: Mounting) -> dict[str, Any]:
    return {
        "angle_deg": place.angle_deg,
        "sigma_deg": place.sigma_deg,
        "axis_lidar": _list(place.axis),
        "unknown_axis_lidar": _list(place.unknown_axis),
        "rotation": place.R_lidar_imu.tolist(),
        "correlation": place.correlation,
    }


def _offset(place: Mounting) -> dict[str, float]:
    return {
        "found_ms": place.time_offset_s * 1e3,
        "sigma_ms": place.time_sigma_s * 1e3,
        "stated_ms": place.stated_offset_s * 1e3,
        "limit_ms": place.delay_limit_s * 1e3,
    }


def _list(values: Any) -> list[float] | None:
    return None if values is None else [float(v) for v in values]


def show(report: Report) -> None:
    """Tables on stdout, then one line for each finding, problems last."""
    console = Console()
    console.print(_streams(report.streams))
    console.print(_estimates(report))
    if report.table is not None:
        console.print(_table_one(report))
    ranked = sorted(report.findings, key=lambda finding: finding.severity == "problem")
    for finding in ranked:
        style = "bold red" if finding.severity == "problem" else "dim"
        console.print(Text(f"{finding.severity}: {finding.line}", style=style), soft_wrap=True)
    count = len(problems(report.findings))
    console.print("no problem found" if count == 0 else f"{count} problem{'s' if count > 1 else ''} found")


def _streams(streams: dict[str, StreamStatistics]) -> Table:
    table = Table("stream", "messages", "Hz", "gaps", "longest gap s", "backwards", "duplicates")
    for name, s in streams.items():
        numbers = (s.count, f"{s.rate_hz:.1f}", s.gaps, f"{s.longest_gap_s:.2f}", s.backwards, s.duplicates)
        table.add_row(name, *map(str, numbers))
    return table


def _estimates(report: Report) -> Table:
    table = Table("", "found", "robot file")
    seen, lidar = report.layout, report.robot.lidar
    table.add_row("rings with points", str(seen.rings_seen), str(lidar.rings))
    table.add_row("columns a turn", "unknown" if seen.columns is None else f"{seen.columns:.0f}", str(lidar.columns))
    ranges = f"{seen.min_range_m:.2f} to {seen.max_range_m:.2f}"
    table.add_row("range m", ranges, f"{lidar.min_range_m:g} to {lidar.max_range_m:g}")
    table.add_row("points of a scan span ms", f"{seen.span_s * 1e3:.1f}", f"{1e3 / lidar.rate_hz:.1f}")
    if (times := report.point_times) is not None:
        table.add_row("points move by so much of their time", f"{times.share:z.2f} +- {times.sigma:.2f}", "1")
    table.add_row("points that are NaN", f"{seen.nan_share:.0%}", "")
    if report.imu is not None:
        table.add_row("gravity m/s^2", f"{report.imu.gravity_mps2:.3f}", f"{report.robot.gravity_mps2:g}")
        _add_mounting(table, report.imu.mounting)
    return table


def _add_mounting(table: Table, place: Mounting | None) -> None:
    if place is None:
        table.add_row("T_lidar_imu, time offset", "the motion does not tell", "")
        return
    known = "" if place.unknown_axis is None else ", one axis unknown"
    off = f"{place.angle_deg:.2f} +- {place.sigma_deg:.2f} away{known}"
    table.add_row("rotation of T_lidar_imu deg", off, "0")
    offset = f"{place.time_offset_s * 1e3:z.1f} +- {place.time_sigma_s * 1e3:.1f}"
    table.add_row("IMU time offset ms", offset, f"{place.stated_offset_s * 1e3:zg}")


def _table_one(report: Report) -> Table:
    row = report.table
    assert row is not None
    table = Table("scans", "elevation change m", "trajectory length m", "max rotation speed deg/s")
    table.title = f"Table I, first {report.recorded_s:.0f} s"
    numbers = (f"{row.elevation_change_m:z.1f}", f"{row.path_m:.0f}", f"{row.max_rotation_degps:.1f}")
    table.add_row(str(row.scans), *numbers)
    return table
