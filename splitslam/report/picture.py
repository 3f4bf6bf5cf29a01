"""One picture of a run: what the README shows."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from splitslam.ply import read_points
from splitslam.report import plots
from splitslam.report.map_view import draw_map, top_view
from splitslam.report.style import png, styled

if TYPE_CHECKING:
    from splitslam.run.orchestrate import Run


def write_picture(run: Run, path: Path) -> None:
    """The map from above; beside it error (or correction), bytes and latency over time. A PNG."""
    with styled():
        figure = Figure(figsize=(13.0, 6.6), layout="constrained")
        grid = figure.add_gridspec(3, 2, width_ratios=(1.6, 1.0))
        view = top_view(read_points(run.ply), run.trajectory.positions_m)
        draw_map(
            figure.add_subplot(grid[:, 0]), view, run.trajectory, np.array(run.keyframes_map).reshape(-1, 3), run.loops
        )
        draws = (
            plots.draw_corrections if run.truth is None else plots.draw_errors,
            plots.draw_bytes,
            plots.draw_latency,
        )
        for row, draw in enumerate(draws):
            axes = figure.add_subplot(grid[row, 1])
            draw(axes, run)
            if row < len(draws) - 1:
                axes.set_xlabel("")
        path.write_bytes(png(figure, dpi=120))
