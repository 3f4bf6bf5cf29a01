"""The map seen from above: colour is height, strength is how many points a cell holds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from numpy.typing import NDArray

from splitslam.report.style import INK, ORANGE
from splitslam.tum import Trajectory

_CELLS = 900  # along the longer side
_CHUNK = 1 << 20
_MARGIN_M, _BORDER_M = 10.0, 2.0  # around the path, and around the points
_COLOURS = ListedColormap(colormaps["viridis"](np.linspace(0.0, 0.9, 256)))  # its last yellow is lost on white
Extent = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True, eq=False)
class TopView:
    """A grid over x and y of `map`. rgba: (rows, columns, 4), row 0 at the lowest y. extent_m: xmin, xmax, ymin, ymax.

    height_m: what the first and the last colour stand for.
    """

    rgba: NDArray[np.float32]
    extent_m: Extent
    height_m: tuple[float, float]


def top_view(points: NDArray[np.float32], path_m: NDArray[np.float64]) -> TopView:
    """points: (N, 4) in `map`. path_m: (M, 3); the view is what lies around it."""
    x0, y0 = path_m[:, :2].min(axis=0) - _MARGIN_M
    x1, y1 = path_m[:, :2].max(axis=0) + _MARGIN_M
    sample = points[:: max(1, len(points) // 200_000)]
    if len(sample):  # where the points are, without the stray ones far away
        low, high = np.percentile(sample[:, :2], [2, 98], axis=0)
        (x0, y0), (x1, y1) = np.minimum((x0, y0), low - _BORDER_M), np.maximum((x1, y1), high + _BORDER_M)
    cell_m = max(x1 - x0, y1 - y0) / _CELLS
    columns, rows = int(np.ceil((x1 - x0) / cell_m)), int(np.ceil((y1 - y0) / cell_m))
    count, height = np.zeros(rows * columns), np.zeros(rows * columns)
    for start in range(0, len(points), _CHUNK):
        chunk = points[start : start + _CHUNK].astype(np.float64)
        column, row = ((chunk[:, :2] - (x0, y0)) / cell_m).astype(np.int64).T
        within = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        cell = (row * columns + column)[within]
        count += np.bincount(cell, minlength=rows * columns)
        height += np.bincount(cell, chunk[within, 2], minlength=rows * columns)
    extent_m = float(x0), float(x0 + columns * cell_m), float(y0), float(y0 + rows * cell_m)
    return _coloured(count.reshape(rows, columns), height.reshape(rows, columns), extent_m)


def _coloured(count: NDArray[np.float64], height: NDArray[np.float64], extent_m: Extent) -> TopView:
    filled = count > 0
    mean_m = np.divide(height, count, out=np.zeros_like(height), where=filled)
    low, high = np.percentile(mean_m[filled], [2, 98]) if filled.any() else (0.0, 1.0)
    high = max(high, low + 0.5)
    rgba = _COLOURS(Normalize(low, high, clip=True)(mean_m)).astype(np.float32)
    full = np.log1p(np.percentile(count[filled], 90)) if filled.any() else 1.0
    rgba[..., 3] = np.where(filled, np.clip(0.25 + 0.75 * np.log1p(count) / full, 0.0, 1.0), 0.0)
    return TopView(rgba, extent_m, (float(low), float(high)))


def draw_map(
    axes: Axes,
    view: TopView,
    trajectory: Trajectory,
    keyframes_map: NDArray[np.float64],
    loops: Sequence[tuple[int, int]] = (),
) -> None:
    """The view with the path over it. keyframes_map: (K, 3) positions; loops: pairs of them that a closure joins."""
    axes.imshow(view.rgba, extent=view.extent_m, origin="lower", interpolation="nearest", aspect="equal")
    xy = trajectory.positions_m[:, :2]
    axes.plot(*xy.T, color="white", lw=3.2, solid_capstyle="round")
    axes.plot(*xy.T, color="#d32f2f", lw=1.5, label="trajectory")
    if len(keyframes_map):
        axes.plot(*keyframes_map[:, :2].T, ".", color="#7f0000", ms=3.2, label=f"keyframes ({len(keyframes_map)})")
    ends = keyframes_map[np.array(loops, int).reshape(-1, 2)][..., :2]
    for k, pair in enumerate(ends):
        axes.plot(*pair.T, "-o", color=ORANGE, lw=1.4, ms=3.5, label=f"loop closures ({len(ends)})" if k == 0 else None)
    axes.plot(*xy[0], "o", mfc="white", mec=INK, ms=6, mew=1.4, label="start")
    axes.plot(*xy[-1], "s", mfc=INK, mec="white", ms=6, mew=1.0, label="end")
    axes.set(xlabel="x in map (m)", ylabel="y in map (m)")
    axes.grid(False)
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=6, borderaxespad=0.3, handletextpad=0.5)
    colours = ScalarMappable(Normalize(*view.height_m), _COLOURS)
    bar = axes.figure.colorbar(colours, ax=axes, shrink=0.6, pad=0.02, aspect=28)
    bar.set_label("mean height of the points (m)")
