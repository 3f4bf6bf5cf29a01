"""The command `splitslam`. What a command needs is imported inside it: `--help` must not wait for numba or gtsam."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from splitslam.errors import InputError

_UsageError: Any = typer.BadParameter.__base__  # of the click that typer brings along or, in older ones, depends on
_INTERRUPTED = 130

app = typer.Typer(
    name="splitslam",
    help="LiDAR SLAM split between a robot and a map service.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


@app.callback(invoke_without_command=True)
def _options(version: Annotated[bool, typer.Option("--version", help="Print the version and exit.")] = False) -> None:
    if version:
        from importlib.metadata import version as installed

        print(installed("splitslam"))
        raise typer.Exit


@app.command("eval")
def evaluate(
    estimate: Annotated[Path, typer.Argument(metavar="ESTIMATE.tum", help="The trajectory to score.")],
    truth: Annotated[Path, typer.Option(metavar="TRUTH.tum", help="The true trajectory.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Score a trajectory against the truth: ATE, RPE over 1 s and 10 m, end error."""
    from splitslam import evaluate as scoring

    result = scoring.evaluate_files(estimate, truth)
    print(scoring.as_json(result)) if as_json else scoring.show(result)


def main() -> None:
    """Entry point: exit code 2 and one line on stderr for whatever the user can mend."""
    try:
        sys.exit(typer.main.get_command(app)(prog_name="splitslam", standalone_mode=False))
    except InputError as error:
        _fail(str(error), error.exit_code)
    except _UsageError as error:
        context = getattr(error, "ctx", None)
        command = context.command_path if context else "splitslam"
        _fail(f"{command}: {error.format_message().rstrip('.')} (see `{command} --help`)", 2)
    except (KeyboardInterrupt, typer.Abort):
        _fail("interrupted", _INTERRUPTED)


def _fail(line: str, exit_code: int) -> None:
    print(line, file=sys.stderr)
    sys.exit(exit_code)


if __name__ == "__main__":
    main()
