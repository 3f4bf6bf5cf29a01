"""The plots of a run besides the map."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from splitslam.alignment import aligned, interpolate
from splitslam.evaluate import inside
from splitslam.report.style import BLUE, GREEN, INK, LIGHT_BLUE, ORANGE, TRUTH
from splitslam.tum import Trajectory

if TYPE_CHECKING:
    from splitslam.run.orchestrate import Run

_SPEED_NS = 500_000_000
_SIDES = (("edge", "edge_ms", BLUE), ("map", "map_ms", GREEN))


def draw_against_truth(axes: Axes, run: Run) -> None:
    """Trajectory from above, moved rigidly onto the truth."""
    assert run.truth is not None
    scored, reference = _pair(run.trajectory, run.truth)
    axes.plot(*reference.positions_m[:, :2].T, color=TRUTH, lw=4.0, solid_capstyle="round", label="truth")
    axes.plot(*aligned(scored, reference)[:, :2].T, color=BLUE, lw=1.3, label="trajectory")
    axes.set(xlabel="x of the truth (m)", ylabel="y of the truth (m)", title="Trajectory against truth")
    axes.set_aspect("equal", adjustable="datalim")
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, borderaxespad=0.2)


def draw_errors(axes: Axes, run: Run) -> None:
    """Position error after alignment over time, final and online."""
    assert run.truth is not None
    for name, estimate, colour in (("online", run.online, ORANGE), ("final", run.trajectory, BLUE)):
        scored, reference = _pair(estimate, run.truth)
        error_m = np.linalg.norm(aligned(scored, reference) - reference.positions_m, axis=1)
        rms_mm = 1e3 * float(np.sqrt(np.mean(error_m**2)))
        axes.plot(
            _seconds(scored.stamps_ns, run), 1e3 * error_m, color=colour, lw=1.1, label=f"{name}, RMSE {rms_mm:.0f} mm"
        )
    axes.set(xlabel="time (s)", ylabel="position error (mm)", title="Error after alignment")
    axes.set_ylim(bottom=0)
    _room_for_legend(axes)


def draw_height(axes: Axes, run: Run) -> None:
    """Without a truth: how high the sensor was, final and online."""
    for name, estimate, colour in (("online", run.online, ORANGE), ("final", run.trajectory, BLUE)):
        axes.plot(_seconds(estimate.stamps_ns, run), estimate.positions_m[:, 2], color=colour, lw=1.1, label=name)
    axes.set(xlabel="time (s)", ylabel="z in map (m)", title="Height of the sensor")
    _room_for_legend(axes)


def draw_speed(axes: Axes, run: Run) -> None:
    """Without a truth: how fast the sensor moved, over half seconds."""
    stamps_ns, positions_m = run.trajectory.stamps_ns, run.trajectory.positions_m
    after = np.searchsorted(stamps_ns, stamps_ns + _SPEED_NS).clip(max=len(stamps_ns) - 1)
    rows = np.flatnonzero(after > np.arange(len(stamps_ns)))
    step_m = np.linalg.norm(positions_m[after[rows]] - positions_m[rows], axis=1)
    over_s = (stamps_ns[after[rows]] - stamps_ns[rows]) * 1e-9
    axes.plot(_seconds(stamps_ns[rows], run), step_m / over_s, color=BLUE, lw=1.1)
    axes.set(xlabel="time (s)", ylabel="speed (m/s)", title="Speed of the sensor")
    axes.set_ylim(bottom=0)


def draw_corrections(axes: Axes, run: Run) -> None:
    """How far the final trajectory lies from what was answered at the time."""
    online, final = _pair(run.online, run.trajectory)
    distance_m = np.linalg.norm(online.positions_m - final.positions_m, axis=1)
    axes.plot(_seconds(online.stamps_ns, run), 1e3 * distance_m, color=GREEN, lw=1.1)
    axes.set(xlabel="time (s)", ylabel="difference (mm)", title="Online pose against final pose")
    axes.set_ylim(bottom=0)


def draw_bytes(axes: Axes, run: Run) -> None:
    """Encoded size of each scan, dense frames apart."""
    at_s = _seconds(np.array(run.edge["stamps_ns_by_scan"], np.int64), run)
    size_kb = np.array(run.edge["bytes_by_scan"]) / 1e3
    dense = np.array(run.edge["dense_by_scan"], bool)
    for name, rows, colour in (("sparse", ~dense, LIGHT_BLUE), ("dense", dense, BLUE)):
        if rows.any():
            label = f"{name}, mean {size_kb[rows].mean():.1f} kB"
            axes.plot(at_s[rows], size_kb[rows], ".", color=colour, ms=3.5, rasterized=True, label=label)
    axes.set(xlabel="time (s)", ylabel="payload (kB)", title="Bytes per scan")
    axes.set_ylim(bottom=0)
    _room_for_legend(axes)


def draw_latency(axes: Axes, run: Run) -> None:
    """From the frame handed over to the answer received."""
    trips = [(at, ms) for at, ms in zip(*_trips(run), strict=True) if ms is not None]
    if trips:
        at_ns, trip_ms = np.array([t[0] for t in trips], np.int64), np.array([t[1] for t in trips], float)
        axes.plot(_seconds(at_ns, run), trip_ms, ".", color=ORANGE, ms=3.5, rasterized=True)
        p50, p99 = np.percentile(trip_ms, [50, 99])
        for value, style in ((p50, "-"), (p99, "--")):
            axes.axhline(value, color=INK, lw=0.9, ls=style)
        axes.plot([], [], "-", color=INK, lw=0.9, label=f"p50 {p50:.1f} ms")
        axes.plot([], [], "--", color=INK, lw=0.9, label=f"p99 {p99:.1f} ms")
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter("{x:g}")
        axes.set_ylim(0.8 * trip_ms.min(), 2.0 * trip_ms.max())
        axes.legend(loc="upper left", ncols=2)
    axes.set(xlabel="time (s)", ylabel="round trip (ms)", title="Frame to answer")


def draw_stages(axes: Axes, run: Run) -> None:
    """CPU time of each stage a scan: mean as a bar, p99 as a mark."""
    rows: list[tuple[str, dict[str, float], str]] = []
    for side, key, colour in _SIDES:
        stages = {stage: times for stage, times in run.report[key].items() if times and stage != "total"}
        rows += [(f"{side}: {stage}  {times['mean']:.2f}", times, colour) for stage, times in stages.items()]
    at = np.arange(len(rows))[::-1]
    axes.barh(at, [times["mean"] for _, times, _ in rows], height=0.6, color=[colour for *_, colour in rows])
    axes.plot([times["p99"] for _, times, _ in rows], at, "|", color=INK, ms=11, mew=1.6)
    axes.set_yticks(at, [name for name, *_ in rows])
    axes.tick_params("y", length=0, labelcolor=INK)
    axes.set(xlabel="CPU time per scan (ms): bar mean, mark p99", title="Where the time goes")
    axes.grid(axis="y", visible=False)
    axes.set_xlim(left=0)


def figure(width_in: float, height_in: float, columns: int = 1) -> tuple[Figure, Any]:
    """A figure and its axes beside each other."""
    made = Figure(figsize=(width_in, height_in), layout="constrained")
    return made, made.subplots(1, columns)


def _pair(estimate: Trajectory, reference: Trajectory) -> tuple[Trajectory, Trajectory]:
    scored = estimate[inside(estimate, reference)]
    return scored, interpolate(reference, scored.stamps_ns)


def _trips(run: Run) -> tuple[list[int], list[float | None]]:
    return run.edge["stamps_ns_by_scan"], run.edge["round_trip_ms_by_scan"]


def _seconds(stamps_ns: np.ndarray, run: Run) -> np.ndarray:
    return (stamps_ns - run.trajectory.stamps_ns[0]) * 1e-9


def _room_for_legend(axes: Axes) -> None:
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + 0.18 * (high - low))
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="upper left", ncols=2)
