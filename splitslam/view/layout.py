"""How it looks when it opens: the map large, below it latency, uplink, doubt and what has happened."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import rerun.blueprint as rrb
from numpy.typing import NDArray

from splitslam.view.colours import BACKGROUND
from splitslam.view.scene import TIMELINE


@dataclass(frozen=True, slots=True)
class Eye:
    """Where one looks from, and at what; m, frame `map`."""

    position_m: tuple[float, float, float]
    target_m: tuple[float, float, float]


_AROUND_M = 12.0
AT_THE_START = Eye((-18.0, -22.0, 24.0), (4.0, 0.0, 0.0))  # of a map whose size is not known yet


def eye_over(positions_map: NDArray) -> Eye:
    """From the south and above, so that a way through (N, 3) and what is seen from there fill the view."""
    if not len(positions_map):
        return AT_THE_START
    low, high = positions_map.min(axis=0), positions_map.max(axis=0)
    centre, size_m = (low + high) / 2.0, float(np.linalg.norm((high - low)[:2])) + _AROUND_M
    position = centre + size_m * np.array([-0.15, -0.6, 0.65])
    x, y, z = position.tolist()
    return Eye((x, y, z), (float(centre[0]), float(centre[1]), float(centre[2])))


def layout(eye: Eye) -> rrb.Blueprint:
    """The time goes along with what comes, so that a finished run is seen at its end."""
    world = rrb.Spatial3DView(
        origin="/world",
        name="Map",
        background=rrb.Background(color=BACKGROUND),
        line_grid=rrb.LineGrid3D(visible=False),
        eye_controls=rrb.EyeControls3D(position=eye.position_m, look_target=eye.target_m, eye_up=(0.0, 0.0, 1.0)),
    )
    plots = rrb.Horizontal(
        rrb.TimeSeriesView(origin="/latency", name="Latency, ms"),
        rrb.TimeSeriesView(origin="/uplink", name="Uplink, kbit/s"),
        rrb.TimeSeriesView(origin="/doubt", name="Position, 1 sigma, mm"),
        rrb.TextLogView(
            origin="/events",
            name="Events",
            columns=rrb.TextLogColumns(timeline_columns=[], text_log_columns=["body", "entitypath"]),
        ),
    )
    time = rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="following")
    return rrb.Blueprint(rrb.Vertical(world, plots, row_shares=[7, 3]), time, collapse_panels=True)
