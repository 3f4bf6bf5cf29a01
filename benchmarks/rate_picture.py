"""The cells of rate_distortion.py as one picture and one Markdown table."""

from __future__ import annotations

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.cells import Cell
from benchmarks.drives import Case
from benchmarks.tables import markdown
from splitslam.report.style import BLUE, GREEN, INK, ORANGE, png, styled

NAMES = {
    "ours": "ours",
    "lio_sam_zstd": "LIO-SAM's features, Morton + zstd",
    "draco": "scan thinned to voxels, Draco",
}
_COLOURS = {"ours": BLUE, "lio_sam_zstd": ORANGE, "draco": GREEN}
_KBPS = (30.0, 2000.0)
Found = dict[Case, dict[str, list[Cell]]]


def table(found: Found) -> str:
    """One row a cell, by rate."""
    rows = [
        [
            case.drive.name,
            NAMES[system],
            cell["level"],
            f"{cell['kbps']:.0f}",
            f"{cell['points_per_scan']:.0f}",
            f"{cell['missing']}",
            _mm(cell, "ate_m"),
            _mm(cell, "rpe_1s_m"),
        ]
        for case, systems in found.items()
        for system, cells in systems.items()
        for cell in sorted(cells, key=lambda cell: cell["kbps"])
    ]
    return markdown(
        ["drive", "what is sent", "setting", "kbit/s", "points a scan", "scans left out", "ATE, mm", "RPE 1 s, mm"],
        rows,
    )


def _mm(cell: Cell, key: str) -> str:
    value_m = cell["score"][key]
    if cell["score"]["failed"] or value_m is None:
        return "fails" if value_m is None else f"fails ({value_m:.1f} m)"
    return f"{1e3 * value_m:.1f}"


def draw(found: Found, default: str) -> bytes:
    """A PNG: ATE against the rate, one panel a drive. default: the level of ours that gets a ring."""
    with styled():
        figure = Figure(figsize=(6.2 * max(1, len(found)), 4.6), layout="constrained")
        panels = figure.subplots(1, max(1, len(found)), squeeze=False)[0]
        for axes, (case, systems) in zip(panels, found.items(), strict=False):
            for system, cells in systems.items():
                _curve(axes, system, [cell for cell in cells if not cell["score"]["failed"]], default)
            axes.set_xscale("log")
            axes.set_yscale("log")
            axes.set_xlim(*_KBPS)
            for axis in (axes.xaxis, axes.yaxis):
                axis.set_major_formatter("{x:g}")
            axes.set_xticks([40, 70, 120, 250, 500, 1000])
            axes.minorticks_off()
            axes.set(xlabel="kbit/s", ylabel="ATE (mm)", title=case.drive.name)
            axes.legend(loc="upper right")
        return png(figure, dpi=110)


def _curve(axes: Axes, system: str, cells: list[Cell], default: str) -> None:
    cells = sorted(cells, key=lambda cell: cell["kbps"])
    x, y = [cell["kbps"] for cell in cells], [1e3 * cell["score"]["ate_m"] for cell in cells]
    axes.plot(x, y, "o-", color=_COLOURS[system], ms=4.5, lw=1.8, label=NAMES[system])
    for cell, kbps, ate_mm in zip(cells, x, y, strict=True):
        if system == "ours" and cell["level"] == default:
            axes.plot([kbps], [ate_mm], "o", mfc="none", mec=INK, ms=11, label="our default")
