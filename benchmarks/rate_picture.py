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
_KBPS, _MM = (30.0, 2000.0), (0.8, 120.0)
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
                _curve(axes, system, cells, default)
            axes.set_xscale("log")
            axes.set_yscale("log")
            axes.set_xlim(*_KBPS)
            for axis in (axes.xaxis, axes.yaxis):
                axis.set_major_formatter("{x:g}")
            axes.set_xticks([40, 70, 120, 250, 500, 1000])
            axes.set_yticks([1, 2, 5, 10, 20, 50, 100])
            axes.set_ylim(*_MM)
            axes.minorticks_off()
            axes.set(xlabel="kbit/s", ylabel="ATE (mm)", title=case.drive.name)
            axes.legend(loc="upper right", bbox_to_anchor=(1.0, 0.95))
            axes.annotate("x: fails", (1.0, 1.02), xycoords="axes fraction", ha="right", fontsize=7)
        return png(figure, dpi=110)


def _curve(axes: Axes, system: str, cells: list[Cell], default: str) -> None:
    """Thinned in space: a line; in time: a dashed one that starts with every scan; failed: a cross at the top."""
    cells, colour = sorted(cells, key=lambda cell: cell["kbps"]), _COLOURS[system]
    good = [cell for cell in cells if not cell["score"]["failed"]]
    in_space = [cell for cell in good if not _in_time(cell)]
    axes.plot(*_xy(in_space), "o-", color=colour, ms=4.5, lw=1.8, label=NAMES[system])
    if in_time := [cell for cell in good if _in_time(cell)]:
        label = f"{NAMES[system]}: every nth scan"
        axes.plot(*_xy([*in_time, *in_space[-1:]]), "o--", color=colour, mfc="white", ms=4.5, lw=1.2, label=label)
    if failed := [cell["kbps"] for cell in cells if cell["score"]["failed"]]:
        top = axes.get_xaxis_transform()
        axes.plot(failed, [0.97] * len(failed), "x", color=colour, ms=7, mew=2, transform=top, clip_on=False)
    if system == "ours":
        axes.plot(*_xy([cell for cell in good if cell["level"] == default]), "o", mfc="none", mec=INK, ms=11)


def _in_time(cell: Cell) -> bool:
    return cell["level"].startswith("every")


def _xy(cells: list[Cell]) -> tuple[list[float], list[float]]:
    return [cell["kbps"] for cell in cells], [1e3 * cell["score"]["ate_m"] for cell in cells]
