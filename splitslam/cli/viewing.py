"""`splitslam view`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def view(
    target: Annotated[
        str,
        typer.Argument(metavar="[SERVER | DIR]", help="HOST:PORT of a map service, a run's folder, or a .rrd file."),
    ] = "127.0.0.1:50051",
    web: Annotated[
        bool, typer.Option("--web", help="For a browser instead of in a window; prints the address.")
    ] = False,
    browser: Annotated[bool, typer.Option("--open", help="With --web: open a browser there.")] = False,
    save: Annotated[Path | None, typer.Option(metavar="FILE.rrd", help="Write a recording instead.")] = None,
    robot: Annotated[str, typer.Option(metavar="ID", help="This robot alone.")] = "",
    site: Annotated[str, typer.Option(metavar="ID", help="This site alone.")] = "",
    session: Annotated[str, typer.Option(metavar="ID", help="What the service has stored of this session.")] = "",
    voxel: Annotated[float, typer.Option(metavar="M", help="The map is thinned to; 0: every point.")] = 0.1,
    points: Annotated[
        int | None,
        typer.Option(metavar="N", help="Of all maps at most, beyond: coarser; 0: no bound. [20000 with --web, else 0]"),
    ] = None,
    memory: Annotated[
        str, typer.Option(metavar="SIZE", help="Kept for who opens later, and by the window; the oldest goes.")
    ] = "1GiB",
    port: Annotated[int, typer.Option(metavar="N", min=0, max=65535, help="Of the data, on loopback; 0: any.")] = 0,
    web_port: Annotated[int, typer.Option(metavar="N", min=0, max=65535, help="Of the page; 0: any.")] = 0,
    seconds: Annotated[float | None, typer.Option(metavar="S", help="End after so long.")] = None,
    ca: Annotated[
        Path | None, typer.Option(metavar="FILE", help="The fleet's authority, for a service with TLS.")
    ] = None,
    cert: Annotated[Path | None, typer.Option(metavar="FILE", help="Our certificate.")] = None,
    key: Annotated[Path | None, typer.Option(metavar="FILE", help="Its key.")] = None,
    token: Annotated[Path | None, typer.Option(metavar="FILE", help="A token instead of a certificate.")] = None,
    insecure: Annotated[bool, typer.Option("--insecure", help="No TLS to a service on another machine.")] = False,
) -> None:
    """Maps, trajectories, features and plots in Rerun: of robots live, or of a finished run."""
    from pydantic import ValidationError

    from splitslam.errors import InputError
    from splitslam.security.settings import ClientTls
    from splitslam.view.options import ViewOptions, check_view_installed

    try:
        tls = ClientTls(ca=ca, cert=cert, key=key, token=token, insecure=insecure)
    except ValidationError as error:
        raise InputError(f"splitslam view: {error.errors()[0]['msg'].removeprefix('Value error, ')}") from None
    options = ViewOptions(
        target, save, web, browser, port, web_port, memory, voxel, points, robot, site, session, seconds, tls
    )
    check_view_installed()
    from splitslam.view.command import run_view

    run_view(options)
