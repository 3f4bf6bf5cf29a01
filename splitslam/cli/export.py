"""`splitslam export`: a map for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def export(
    session: Annotated[str, typer.Argument(metavar="SESSION", help="ROBOT/RUN, or the folder of a run.")],
    format_: Annotated[
        str,
        typer.Option(
            "--format",
            metavar="NAME",
            help="Cloud: ply, pcd, las, laz, copc, e57. Trajectory: tum, kitti, geojson. Pose graph: g2o. "
            "Occupancy grid for Nav2: grid.",
        ),
    ] = "ply",
    server: Annotated[str | None, typer.Option(metavar="HOST:PORT", help="A running map service.")] = None,
    store: Annotated[str | None, typer.Option(metavar="URL", help="sqlite:///FILE or postgresql://...")] = None,
    tls: Annotated[
        Path | None, typer.Option(metavar="FILE", help="YAML with ca, cert, key, token, as the agent's section tls.")
    ] = None,
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="Default: map.ply and the like, here.")] = None,
    voxel: Annotated[float, typer.Option(metavar="M", help="Clouds: one point a voxel; 0: every point.")] = 0.0,
    frame: Annotated[
        str, typer.Option(metavar="NAME", help="Clouds: map, utm, or auto: utm when GNSS was used.")
    ] = "auto",
    resolution: Annotated[float, typer.Option(metavar="M", help="Grid: side of a cell.")] = 0.05,
    min_height: Annotated[float, typer.Option(metavar="M", help="Grid: over the ground, what is in the way.")] = 0.2,
    max_height: Annotated[float, typer.Option(metavar="M", help="Grid: over the ground, what is above it all.")] = 2.0,
    range_m: Annotated[float, typer.Option("--range", metavar="M", help="Grid: how far rays count.")] = 20.0,
    dense: Annotated[
        bool, typer.Option("--dense/--no-dense", help="Whole scans of keyframes where the robot has sent them.")
    ] = True,
    force: Annotated[bool, typer.Option("--force", help="Replace a file that is there.")] = False,
) -> None:
    """Write a session's map, trajectory, pose graph or occupancy grid to a file that others read."""
    from splitslam.export.command import ExportOptions
    from splitslam.export.command import export as run_export
    from splitslam.export.grid.settings import GridSettings
    from splitslam.run.progress import Progress

    grid = GridSettings(resolution, min_height, max_height, range_m)
    options = ExportOptions(session, format_, server, store, tls, out, voxel, frame, force, grid, dense)
    with Progress(unit="parts") as progress:
        done = run_export(options, progress)
    print(f"{done.path}: {done.note}")
