"""Reads docs/paper.md and finds what its cells name."""

from __future__ import annotations

import ast
import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path

HEADER = ("paper", "what it is", "code", "command", "test", "state")
CODE_SPAN = re.compile(r"`([^`]+)`")
ISSUE = re.compile(r"\bissue ([3-9])\b")
OTHER_DEFINITIONS = {".sv": r"^module (\w+)", ".v": r"^module (\w+)", ".tcl": r"^proc (\w+)"}
DEFINITIONS = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)


@dataclass(frozen=True)
class Row:
    paper: str
    what: str
    code: tuple[str, ...]
    commands: tuple[str, ...]
    tests: tuple[str, ...]
    state: str

    @property
    def built(self) -> bool:
        return self.state.startswith("built")

    @property
    def issues(self) -> tuple[int, ...]:
        return tuple(int(number) for number in ISSUE.findall(self.state))


def read_rows(text: str) -> list[Row]:
    """Rows of the first table whose header is HEADER, in order."""
    rows: list[Row] = []
    inside = False
    for line in text.splitlines():
        cells = tuple(cell.strip() for cell in line.strip().strip("|").split("|"))
        if cells == HEADER:
            inside = True
        elif inside and not line.startswith("|"):
            break
        elif inside and not set(line) <= set("|-: "):
            paper, what, code, command, test, state = cells
            spans = [tuple(CODE_SPAN.findall(cell)) for cell in (code, command, test)]
            rows.append(Row(paper, what, spans[0], spans[1], spans[2], state))
    return rows


@cache
def _defined(path: Path) -> frozenset[str]:
    """Names a file defines: top-level functions and classes, and `Class.method`; of hardware its modules and procs."""
    if path.suffix in OTHER_DEFINITIONS:
        return frozenset(re.findall(OTHER_DEFINITIONS[path.suffix], path.read_text(), re.MULTILINE))
    names: set[str] = set()
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, DEFINITIONS):
            names.add(node.name)
        if isinstance(node, ast.ClassDef):
            names.update(f"{node.name}.{child.name}" for child in node.body if isinstance(child, DEFINITIONS))
    return frozenset(names)


def problem_with(reference: str, root: Path) -> str | None:
    """Why `path.py:name` (code or test) does not exist, or None."""
    path, colon, name = reference.partition(":")
    if not colon or not name:
        return f"{reference}: not of the form file:function"
    if not (root / path).is_file():
        return f"{reference}: no such file"
    if name not in _defined(root / path):
        return f"{reference}: {path} defines no {name}"
    return None
