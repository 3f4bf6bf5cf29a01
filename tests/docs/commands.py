"""Finds the commands that a text shows and holds them against the real ones.

A code span may be a part of a command (`splitslam run --server`): `problem_with` looks at names alone. A line of a
block is there to be typed: `mistake_in` has it parsed whole.
"""

from __future__ import annotations

import re
import shlex
import subprocess
from functools import cache
from importlib import import_module
from typing import Any

import typer
import typer.main
from typer.core import TyperCommand, TyperGroup

from tests.conftest import ROOT

PROGRAMS = {
    "splitslam": "splitslam.cli",
    "edge-agent": "edge_agent.__main__",
    "map-service": "map_service.command",
}
FENCE = re.compile(r"^```[a-z]*\n(.*?)^```", re.MULTILINE | re.DOTALL)
SPAN = re.compile(r"`([^`\n]+)`")
PYTHON = ("python", "python3")
_UsageError: Any = typer.BadParameter.__base__
PROMPT = re.compile(r"^(?:\$ )?(?:\.venv/bin/)?")


def shown_in(text: str) -> list[str]:
    """Every line of a fenced block and every code span that starts with one of our programs or with make."""
    lines = [line for block in FENCE.findall(text) for line in block.splitlines()]
    lines += SPAN.findall(FENCE.sub("", text))
    commands = (PROMPT.sub("", line.strip(), count=1) for line in lines)
    return [c for c in commands if c.partition(" ")[0] in (*PROGRAMS, "make") and " " in c]


def python_in(text: str) -> list[str]:
    """Code spans that run something of this repository by Python or pytest."""
    spans = SPAN.findall(FENCE.sub("", text))
    return [span for span in spans if re.match(r"(\.venv/bin/)?(python -m|pytest) [a-z]", span)]


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
    node, rest = _leaf(program, rest)
    if isinstance(node, TyperGroup) and rest and not rest[0].startswith("-"):
        return f"{command}: {node.name or program} has no command {rest[0]}"
    known = {"--help", *(option for parameter in node.params for option in parameter.opts + parameter.secondary_opts)}
    for word in rest:
        if word.startswith("--") and word.strip("[]").partition("=")[0] not in known:
            return f"{command}: {node.name} has no option {word}"
    return None


def mistake_in(line: str) -> str | None:
    """Why a shell line would fail at once, by whoever is to read it (parser, make, Python), or None.

    Raises KeyError for a program that nobody here knows.
    """
    words = shlex.split(line, comments=True)
    program = words[0].rpartition(".venv/bin/")[2]
    if program == "make":
        return problem_with(line) or _not_made(words[1:])
    if program in PYTHON and words[1:2] == ["-m"]:
        program, words = words[2], words[2:]
        if program != "pytest":
            return _not_a_module(program, words[1:])
    if program == "pytest":
        return _no_tests(words[1:])
    node, rest = _leaf(program, words[1:])
    if isinstance(node, TyperGroup):
        return problem_with(" ".join((program, *words[1:])))
    try:
        node.make_context(program, list(rest))
    except typer.Exit:  # --help, --version
        return None
    except _UsageError as error:
        return f"{line}: {error.format_message()}"
    return None


def _leaf(program: str, words: list[str]) -> tuple[TyperGroup | TyperCommand, list[str]]:
    """The command that the first words name, and the others. Raises KeyError for a program that is not ours."""
    node = _root(program)
    while isinstance(node, TyperGroup) and words and not words[0].startswith("-"):
        child = node.commands.get(words[0])
        if child is None:
            break
        assert isinstance(child, TyperGroup | TyperCommand)
        node, words = child, words[1:]
    return node, words


def _not_made(words: list[str]) -> str | None:
    """A target that make cannot make, or a variable that the Makefile does not read, which make would not say."""
    folder = words[words.index("-C") + 1] if "-C" in words else "."
    makefile = (ROOT / folder / "Makefile").read_text()
    for name in (word.partition("=")[0] for word in words if "=" in word):
        if not re.search(rf"\$[({{]{name}[)}}]|\b(?:or|if) \$\({name}\)|^{name} [?:]?=", makefile, re.MULTILINE):
            return f"make {' '.join(words)}: nothing reads {name}"
    done = subprocess.run(("make", "--dry-run", *words), cwd=ROOT, capture_output=True, text=True, timeout=60)
    return done.stderr.strip() if done.returncode else None


def _no_tests(words: list[str]) -> str | None:
    missing = [word for word in words if word.startswith("tests/") and not (ROOT / word).exists()]
    return f"pytest: no {missing[0]}" if missing else None


def _not_a_module(module: str, options: list[str]) -> str | None:
    """By the files alone: importing some of them takes seconds."""
    path = ROOT.joinpath(*module.split("."))
    if not (path.with_suffix(".py").is_file() or (path / "__main__.py").is_file()):
        raise KeyError(module)
    package = path if path.is_dir() else path.parent  # options that several have are in a file of their own
    text = "".join(file.read_text() for file in package.glob("*.py"))
    names = [option.partition("=")[0] for option in options if option.startswith("--")]
    unknown = [name for name in names if f'"{name}"' not in text and not _is_parameter(name, text)]
    return f"python -m {module}: no option {unknown[0]}" if unknown else None


def _is_parameter(option: str, text: str) -> bool:
    """A typer command's option is called as its parameter is."""
    return re.search(rf"\b{option.lstrip('-').replace('-', '_')}: Annotated\[", text) is not None
