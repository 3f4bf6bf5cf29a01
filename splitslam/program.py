"""What the programs have in common: `--version`, and one line with an exit code for whatever the user can mend."""

from __future__ import annotations

import errno
import sys
from typing import Annotated, Any, NoReturn

import typer

from splitslam import __version__
from splitslam.errors import InputError

_DISK = (errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO)
_UsageError: Any = typer.BadParameter.__base__  # of the click that typer brings along or, in older ones, depends on


def program(name: str, about: str) -> typer.Typer:
    """One without commands yet."""
    app = typer.Typer(name=name, help=about, no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False)
    app.callback(invoke_without_command=True)(_options)
    return app


def call(app: typer.Typer, name: str) -> Any:
    """Does what the command line asks for; its exit code, if it has one. A mistake ends the process with 2, a disk that
    fails or is full with 1."""
    try:
        return typer.main.get_command(app)(prog_name=name, standalone_mode=False)
    except InputError as error:
        end(str(error), error.exit_code)
    except _UsageError as error:
        if not error.format_message():  # a program without arguments, whose help is on the screen
            sys.exit(InputError.exit_code)
        context = getattr(error, "ctx", None)
        command = context.command_path if context else name
        end(f"{command}: {error.format_message().rstrip('.')} (see `{command} --help`)", InputError.exit_code)
    except OSError as error:
        if error.errno not in _DISK:
            raise
        end(f"{error.filename or name}: {error.strerror}", 1)


def end(line: str, exit_code: int) -> NoReturn:
    """Says why."""
    print(line, file=sys.stderr)
    sys.exit(exit_code)


def _options(version: Annotated[bool, typer.Option("--version", help="Print the version and exit.")] = False) -> None:
    if version:
        print(__version__)
        raise typer.Exit
