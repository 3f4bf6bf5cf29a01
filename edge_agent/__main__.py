"""The command `edge-agent`. What it needs is imported inside the command: `--help` must not wait for numba or gtsam."""

from __future__ import annotations

import os
import signal
import sys
import threading
from pathlib import Path
from typing import Annotated, Any

import typer

from splitslam.errors import InputError

_UsageError: Any = typer.BadParameter.__base__  # of the click that typer brings along or, in older ones, depends on

app = typer.Typer(
    name="edge-agent",
    help="SplitSLAM on the robot: scans to features, IMU-rate pose, uplink to the map service.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


@app.callback()
def _commands() -> None:
    """Keeps `run` a command of its own."""


@app.command()
def run(
    config: Annotated[Path, typer.Option(metavar="FILE", help="Agent configuration, YAML.")],
    print_config: Annotated[bool, typer.Option("--print-config", help="Print the effective one and exit.")] = False,
) -> None:
    """Run the agent until its source ends or it gets SIGTERM or SIGINT."""
    os.environ.setdefault("GRPC_VERBOSITY", "ERROR")  # gRPC's own lines are not for the robot's operator
    from edge_agent.config import ENVIRONMENT_PREFIX, AgentConfig
    from splitslam.config import dump, load
    from splitslam.logs import configure_logs

    settings = load(AgentConfig, config, ENVIRONMENT_PREFIX)
    if print_config:
        print(dump(settings), end="")
        return
    configure_logs(settings.log.format, settings.log.level)
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    from edge_agent.daemon import run_agent

    run_agent(settings, stop)


def main() -> None:
    """Entry point: exit code 2 and one line on stderr for whatever the user can mend."""
    try:
        sys.exit(typer.main.get_command(app)(prog_name="edge-agent", standalone_mode=False))
    except InputError as error:
        _fail(str(error), error.exit_code)
    except _UsageError as error:
        context = getattr(error, "ctx", None)
        command = context.command_path if context else "edge-agent"
        _fail(f"{command}: {error.format_message().rstrip('.')} (see `{command} --help`)", 2)


def _fail(line: str, exit_code: int) -> None:
    print(line, file=sys.stderr)
    sys.exit(exit_code)


if __name__ == "__main__":
    main()
