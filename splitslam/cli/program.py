"""The program `splitslam`: its commands, and what a mistake looks like."""

from __future__ import annotations

import sys
from typing import Annotated, Any

import typer

from splitslam.cli.bench import bench
from splitslam.cli.export import export
from splitslam.cli.operation import diagnose, top
from splitslam.cli.recordings import check, demo, evaluate, run, sim
from splitslam.cli.sensors import replay
from splitslam.cli.viewing import view
from splitslam.errors import InputError
from splitslam.run.processes import RunFailedError
from splitslam.security.command import certs

_UsageError: Any = typer.BadParameter.__base__  # of the click that typer brings along or, in older ones, depends on
_INTERRUPTED = 130
_COMMANDS = {
    "eval": evaluate,
    "run": run,
    "check": check,
    "export": export,
    "diagnose": diagnose,
    "demo": demo,
    "top": top,
    "view": view,
    "sim": sim,
    "replay": replay,
}

app = typer.Typer(
    name="splitslam",
    help="LiDAR SLAM split between a robot and a map service.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
app.add_typer(bench, name="bench")
app.add_typer(certs, name="certs")
for name, command in _COMMANDS.items():
    app.command(name)(command)


@app.callback(invoke_without_command=True)
def _options(version: Annotated[bool, typer.Option("--version", help="Print the version and exit.")] = False) -> None:
    if version:
        from importlib.metadata import version as installed

        print(installed("splitslam"))
        raise typer.Exit


def main() -> None:
    """Entry point: exit code 2 and one line on stderr for whatever the user can mend."""
    try:
        exit_code = typer.main.get_command(app)(prog_name="splitslam", standalone_mode=False)
        if exit_code == _INTERRUPTED:  # some versions of typer catch Ctrl-C themselves
            raise KeyboardInterrupt
        sys.exit(exit_code)
    except (InputError, RunFailedError) as error:
        _fail(str(error), error.exit_code)
    except _UsageError as error:
        context = getattr(error, "ctx", None)
        command = context.command_path if context else "splitslam"
        _fail(f"{command}: {error.format_message().rstrip('.')} (see `{command} --help`)", 2)
    except OSError as error:  # a full disk, a folder that went away
        _fail(f"{error.filename or 'splitslam'}: {error.strerror or error}", 1)
    except (KeyboardInterrupt, typer.Abort):
        _fail("interrupted", _INTERRUPTED)


def _fail(line: str, exit_code: int) -> None:
    print(line, file=sys.stderr)
    sys.exit(exit_code)
