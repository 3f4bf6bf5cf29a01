"""What the benchmarks' commands share: options that are lists, and errors as one line."""

from __future__ import annotations

import sys

import typer

from splitslam.errors import InputError


def listed(option: str, text: str, known: tuple[str, ...]) -> list[str]:
    """A comma-separated option's parts; InputError for one that is not known."""
    parts = [part.strip() for part in text.split(",") if part.strip()]
    for part in parts:
        if part not in known:
            raise InputError(f"{option}: expected some of {', '.join(known)}, found {part!r}")
    return parts


def run(app: typer.Typer) -> None:
    """Exit code 2 and one line for what the user can mend."""
    try:
        app()
    except InputError as error:
        print(error, file=sys.stderr)
        sys.exit(error.exit_code)
