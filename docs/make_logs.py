"""Writes the tables of docs/logs.md from the code's logging calls: `python -m docs.make_logs` (`--check`: none)."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

from docs.made import ROOT, MadePage

FOLDERS = {"edge": ("edge_agent", "splitslam/security"), "service": ("map_service",)}
LEVELS = ("critical", "error", "exception", "warning", "info", "debug")


@dataclass(frozen=True, slots=True, order=True)
class Line:
    """One logging call. level: "debug to warning" where the code chooses; traceback: it comes with one."""

    event: str
    level: str
    fields: tuple[str, ...]
    traceback: bool


def table(folders: tuple[str, ...]) -> str:
    """A Markdown table, one row an event."""
    files = sorted(file for folder in folders for file in (ROOT / folder).rglob("*.py"))
    lines = sorted({line for file in files for line in lines_of(ast.parse(file.read_text()))})
    rows = ["| event | level | fields |", "|---|---|---|"]
    for line in lines:
        said = ", ".join(f"`{field}`" for field in line.fields)
        rows.append(f"| {line.event} | {line.level}{', with traceback' if line.traceback else ''} | {said} |")
    return "\n".join(rows)


def lines_of(tree: ast.AST) -> Iterator[Line]:
    """Every `_log.LEVEL(...)` in a module; what is assigned to `said` and to `event` before counts as written there."""
    for function in ast.walk(tree):
        if not isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        calls = [node for node in ast.walk(function) if isinstance(node, ast.Call) and _is_logging(node)]
        for call in calls:
            name = call.func.attr if isinstance(call.func, ast.Attribute) else ""
            text, level = (call.args[1], "debug to warning") if name == "log" else (call.args[0], name)
            for event in _texts(text, function):
                traceback = level == "exception"
                yield Line(event, "error" if traceback else level, _fields(call, function), traceback)


def _is_logging(call: ast.Call) -> bool:
    of = call.func
    if not (isinstance(of, ast.Attribute) and isinstance(of.value, ast.Name) and of.value.id == "_log"):
        return False
    return of.attr in (*LEVELS, "log")


def _texts(node: ast.expr, function: ast.AST) -> list[str]:
    """The constant texts that an expression may be."""
    if isinstance(node, ast.Constant):
        return [str(node.value)]
    if isinstance(node, ast.IfExp):
        return _texts(node.body, function) + _texts(node.orelse, function)
    if isinstance(node, ast.Name):
        return [text for value in _assigned(node.id, function) for text in _texts(value, function)]
    return [f"{{{ast.unparse(node)}}}"]


def _fields(call: ast.Call, function: ast.AST) -> tuple[str, ...]:
    extra = next((keyword.value for keyword in call.keywords if keyword.arg == "extra"), None)
    sources = _assigned(extra.id, function) if isinstance(extra, ast.Name) else [extra]
    found: dict[str, None] = {}
    for source in sources:
        for keyword in source.keywords if isinstance(source, ast.Call) else []:
            more = _assigned(keyword.value.id, function) if isinstance(keyword.value, ast.Name) else []
            names = [keyword.arg] if keyword.arg else [key for value in more for key in _keys(value)]
            found.update(dict.fromkeys(str(name) for name in names))
    return tuple(found)


def _assigned(name: str, function: ast.AST) -> list[ast.expr]:
    """Everything a function assigns to a name, or adds to it, or to one of its keys."""
    values: list[ast.expr] = []
    for node in ast.walk(function):
        if isinstance(node, ast.Assign):
            for target in node.targets:
                if isinstance(target, ast.Name) and target.id == name:
                    values.append(node.value)
                if isinstance(target, ast.Subscript) and isinstance(target.value, ast.Name) and target.value.id == name:
                    values.append(ast.Dict([target.slice], [node.value]))
        elif isinstance(node, ast.AnnAssign | ast.AugAssign):
            named = isinstance(node.target, ast.Name) and node.target.id == name
            values += [node.value] if named and node.value is not None else []
    return values


def _keys(node: ast.expr) -> list[str]:
    keys = node.keys if isinstance(node, ast.Dict) else []
    return [str(key.value) for key in keys if isinstance(key, ast.Constant)]


PAGE = MadePage("logs", {side: partial(table, folders) for side, folders in FOLDERS.items()})

if __name__ == "__main__":
    PAGE.main(__doc__)
