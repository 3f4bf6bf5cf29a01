"""The command `map-service`. What serving needs is imported when it is asked for."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated

import typer

from map_service.store_command import sessions_app, store_app
from splitslam.program import call, program

app = program("map-service", "The map service of SplitSLAM: robots' features in, poses and a map out.")
app.add_typer(store_app, name="store")
app.add_typer(sessions_app, name="sessions")


@app.command()
def serve(
    config: Annotated[Path | None, typer.Option(metavar="FILE", help="YAML; defaults without.")] = None,
    listen: Annotated[str | None, typer.Option(metavar="HOST:PORT", help="gRPC; port 0: a free one.")] = None,
    store: Annotated[str | None, typer.Option(metavar="URL", help="SQLAlchemy URL: sqlite:///FILE, ...")] = None,
    workers: Annotated[int | None, typer.Option(min=0, help="Worker processes; 0: by cores.")] = None,
    metrics_port: Annotated[int | None, typer.Option(min=0, max=65535, help="/metrics; 0: a free port.")] = None,
    print_config: Annotated[bool, typer.Option("--print-config", help="Print the effective one and exit.")] = False,
) -> None:
    """Serve robots until SIGTERM."""
    os.environ.setdefault("GRPC_VERBOSITY", "NONE")  # what fails is told in our own words; gRPC's go before them
    from map_service.config import ENV_PREFIX, ServiceConfig
    from splitslam import config as configuration

    effective = configuration.load(ServiceConfig, config, ENV_PREFIX)
    given = {"listen": listen, "store": store, "workers": workers}
    values = effective.model_dump() | {key: value for key, value in given.items() if value is not None}
    if metrics_port is not None:
        values["metrics"] = values["metrics"] | {"port": metrics_port}
    effective = configuration.validate(ServiceConfig, values, "options")
    if print_config:
        print(configuration.dump(effective), end="")
        return
    from map_service.server import serve as run

    run(effective)


@app.command()
def health(
    server: Annotated[str | None, typer.Option(metavar="HOST:PORT", help="Else by its configuration.")] = None,
    config: Annotated[Path | None, typer.Option(metavar="FILE", help="The service's YAML; defaults without.")] = None,
    timeout_s: Annotated[float, typer.Option(min=0.1, help="How long it may take to answer.")] = 2.0,
) -> None:
    """Ask a running service whether it takes robots: exit code 0, or 1 and a line that says why not."""
    from map_service.config import ENV_PREFIX, ServiceConfig
    from map_service.health import problem_with
    from splitslam import config as configuration

    problem = problem_with(configuration.load(ServiceConfig, config, ENV_PREFIX), server, timeout_s)
    if problem is not None:
        print(problem, file=sys.stderr)
        raise typer.Exit(1)


@app.command("warm-up")
def warm_up() -> None:
    """Compile every kernel into the cache, so that no start has to; prints how many there were to compile."""
    import json

    from map_service.kernel_cache import fill

    print(json.dumps(fill().as_dict()))


def main() -> None:
    """Entry point: exit code 2 and one line on stderr for whatever the user can mend."""
    sys.exit(call(app, "map-service"))
