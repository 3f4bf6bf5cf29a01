"""`splitslam top`, `diagnose`: what runs, and what does not."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def top(
    endpoints: Annotated[
        list[str] | None, typer.Argument(metavar="HOST:PORT", help="/metrics of agents and services, or URLs.")
    ] = None,
    every: Annotated[float, typer.Option(metavar="S", help="Seconds between two readings.")] = 2.0,
    once: Annotated[bool, typer.Option("--once", help="Print and exit; 1 when an endpoint gives no answer.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="The same as one JSON list.")] = False,
) -> None:
    """Edge agents and map services live: state, times, bytes, losses. Without endpoints: those of this machine."""
    from splitslam.top.command import run_top

    if not run_top(endpoints or (), every, once, as_json):
        raise typer.Exit(1)


def diagnose(
    edge: Annotated[
        list[str] | None,
        typer.Option(metavar="DIR|URL", help="State directory of an agent here, or http://HOST:PORT of one elsewhere."),
    ] = None,
    config: Annotated[
        Path | None, typer.Option(metavar="FILE", help="The agent's configuration; default: what it was started with.")
    ] = None,
    map_config: Annotated[
        Path | None, typer.Option("--map", metavar="FILE", help="Configuration of a map service of this machine.")
    ] = None,
    log: Annotated[list[Path] | None, typer.Option(metavar="FILE", help="A log besides systemd's journal.")] = None,
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="The bundle; default: by host and time.")] = None,
    raw: Annotated[bool, typer.Option("--raw/--no-raw", help="With the last seconds of raw scans.")] = True,
    as_json: Annotated[bool, typer.Option("--json", help="Print summary.json.")] = False,
) -> None:
    """Write one bundle for whoever is to help: self-checks, raw scans, logs, configuration without secrets."""
    import json

    from splitslam.run.options import check_installed

    check_installed(("server",) if map_config and not edge else ("edge",))
    from splitslam.diagnose.command import DiagnoseOptions
    from splitslam.diagnose.command import diagnose as look
    from splitslam.diagnose.show import show

    asked = DiagnoseOptions(tuple(edge or ()), config, map_config, tuple(log or ()), out, raw)
    diagnosis = look(asked)
    print(json.dumps(diagnosis.as_dict())) if as_json else show(diagnosis)
