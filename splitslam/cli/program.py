"""The program `splitslam`: its commands, and what a mistake looks like."""

from __future__ import annotations

import sys

import typer

from splitslam.cli.bench import bench
from splitslam.cli.export import export
from splitslam.cli.operation import diagnose, top
from splitslam.cli.recordings import check, demo, evaluate, run, sim
from splitslam.cli.sensors import replay
from splitslam.cli.viewing import view
from splitslam.program import call, end, program
from splitslam.run.processes import RunFailedError
from splitslam.security.command import certs

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

app = program("splitslam", "LiDAR SLAM split between a robot and a map service.")
app.add_typer(bench, name="bench")
app.add_typer(certs, name="certs")
for name, command in _COMMANDS.items():
    app.command(name)(command)


def main() -> None:
    """Entry point: exit code 2 and one line on stderr for whatever the user can mend."""
    try:
        exit_code = call(app, "splitslam")
        if exit_code == _INTERRUPTED:  # some versions of typer catch Ctrl-C themselves
            raise KeyboardInterrupt
        sys.exit(exit_code)
    except RunFailedError as error:
        end(str(error), error.exit_code)
    except OSError as error:  # a full disk, a folder that went away
        end(f"{error.filename or 'splitslam'}: {error.strerror or error}", 1)
    except (KeyboardInterrupt, typer.Abort):
        end("interrupted", _INTERRUPTED)
