"""The command `edge-agent`. What it needs is imported inside the command: `--help` must not wait for numba."""

from __future__ import annotations

import faulthandler
import gc
import os
import signal
import sys
import threading
from pathlib import Path
from typing import Annotated

import typer

from splitslam.program import call, program

app = program("edge-agent", "SplitSLAM on the robot: scans to features, IMU-rate pose, uplink to the map service.")


@app.command()
def run(
    config: Annotated[Path, typer.Option(metavar="FILE", help="Agent configuration, YAML.")],
    print_config: Annotated[bool, typer.Option("--print-config", help="Print the effective one and exit.")] = False,
) -> None:
    """Run the agent until its source ends or it gets SIGTERM or SIGINT."""
    os.environ.setdefault("GRPC_VERBOSITY", "NONE")  # gRPC's own lines are not for the robot's operator
    gc.disable()  # until the first scan: what is imported stays
    from edge_agent.config import ENVIRONMENT_PREFIX, AgentConfig
    from edge_agent.service import Reloader, in_service_folders
    from splitslam.config import dump, load
    from splitslam.logs import configure_logs
    from splitslam.notify import Notifier

    settings = in_service_folders(load(AgentConfig, config, ENVIRONMENT_PREFIX), os.environ)
    if print_config:
        print(dump(settings), end="")
        return
    configure_logs(settings.log.format, settings.log.level)
    faulthandler.enable()  # systemd's watchdog ends a stuck agent by SIGABRT: then its log says where it was
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    notifier = Notifier()
    reloading = Reloader(config, settings, notifier)
    signal.signal(signal.SIGHUP, lambda *_: reloading.ask())
    reloading.start()
    from edge_agent.daemon import run_agent

    run_agent(settings, stop, notifier)


@app.command("warm-up")
def warm_up(
    robot: Annotated[Path | None, typer.Option(metavar="FILE", help="Robot file; without, a VLP-16 with IMU.")] = None,
) -> None:
    """Compile every kernel into the cache, so that no start has to; prints how many there were to compile."""
    import json

    from edge_agent.kernel_cache import fill

    print(json.dumps(fill(robot).as_dict()))


@app.command()
def health(
    metrics: Annotated[str, typer.Option(metavar="HOST:PORT", help="Its /metrics.")] = "127.0.0.1:9464",
    timeout_s: Annotated[float, typer.Option(min=0.1, help="How long it may take to answer.")] = 2.0,
) -> None:
    """Ask a running agent whether it is well: exit code 0, or 1 and a line that says why not."""
    from edge_agent.health import problem_with

    problem = problem_with(metrics, timeout_s)
    if problem is not None:
        print(problem, file=sys.stderr)
        raise typer.Exit(1)


def main() -> None:
    """Entry point: exit code 2 and one line on stderr for whatever the user can mend."""
    sys.exit(call(app, "edge-agent"))


if __name__ == "__main__":
    main()
