"""Finds the commands that a text shows and holds them against the real ones."""

from __future__ import annotations

import re
import shlex
from functools import cache
from importlib import import_module

import typer.main
from typer.core import TyperCommand, TyperGroup

from tests.conftest import ROOT

PROGRAMS = {
    "splitslam": "splitslam.cli",
    "edge-agent": "edge_agent.__main__",
    "map-service": "map_service.__main__",
}
FENCE = re.compile(r"^```[a-z]*\n(.*?)^```", re.MULTILINE | re.DOTALL)
SPAN = re.compile(r"`([^`\n]+)`")
PROMPT = re.compile(r"^(?:\$ )?(?:\.venv/bin/)?")


def shown_in(text: str) -> list[str]:
    """Every line of a fenced block and every code span that starts with one of our programs or with make."""
    lines = [line for block in FENCE.findall(text) for line in block.splitlines()]
    lines += SPAN.findall(FENCE.sub("", text))
    commands = (PROMPT.sub("", line.strip(), count=1) for line in lines)
    return [c for c in commands if c.partition(" ")[0] in (*PROGRAMS, "make") and " " in c]


@cache
def _root(program: str) -> TyperGroup | TyperCommand:
    root = typer.main.get_command(import_module(PROGRAMS[program]).app)
    assert isinstance(root, TyperGroup | TyperCommand)
    return root


@cache
def _make_targets(folder: str) -> frozenset[str]:
    return frozenset(re.findall(r"^([a-z-]+):", (ROOT / folder / "Makefile").read_text(), re.MULTILINE))


def problem_with(command: str) -> str | None:
    """Why a command line cannot be typed as it stands (unknown subcommand or option), or None."""
    words = shlex.split(command.replace("...", ""), comments=True)
    program, rest = words[0], words[1:]
    if program == "make":
        folder, rest = (rest[1], rest[2:]) if rest[:1] == ["-C"] else (".", rest)
        targets = [word for word in rest if "=" not in word]
        unknown = [target for target in targets if target not in _make_targets(folder)]
        return f"{command}: no make target {unknown[0]}" if unknown else None
    node = _root(program)
    while isinstance(node, TyperGroup) and rest and not rest[0].startswith("-"):
        child = node.commands.get(rest[0])
        if child is None:
            return f"{command}: {node.name or program} has no command {rest[0]}"
        assert isinstance(child, TyperGroup | TyperCommand)
        node, rest = child, rest[1:]
    known = {"--help", *(option for parameter in node.params for option in parameter.opts + parameter.secondary_opts)}
    for word in rest:
        if word.startswith("--") and word.strip("[]").partition("=")[0] not in known:
            return f"{command}: {node.name} has no option {word}"
    return None
