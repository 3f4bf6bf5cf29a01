"""Kernels are plain arithmetic: what numba compiles here it compiles on the board's ARM cores too."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from tests.conftest import ROOT

MODULES = sorted(p for part in ("splitslam", "edge_agent", "map_service") for p in (ROOT / part).rglob("_*kernels.py"))
PLAIN = ("__future__", "math", "numpy", "splitslam", "edge_agent", "map_service")


def imports(path: Path) -> set[str]:
    """module, or module.name of what is taken out of numba."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            module = node.module or ""
            found |= {f"{module}.{alias.name}" for alias in node.names} if module.startswith("numba") else {module}
    return found


def is_plain(name: str) -> bool:
    return name == "numba.njit" or name.split(".")[0] in PLAIN


def test_there_are_kernels_to_look_at():
    assert len(MODULES) > 15


@pytest.mark.parametrize("path", MODULES, ids=lambda path: path.stem)
def test_a_kernel_module_takes_nothing_from_numba_but_njit(path: Path):
    assert {name for name in imports(path) if not is_plain(name)} == set()


@pytest.mark.parametrize(
    "line", ["from numba import intrinsic", "import llvmlite.ir", "from numba.core import cgutils"]
)
def test_what_would_reach_below_is_seen(line: str, tmp_path: Path):
    (tmp_path / "_kernels.py").write_text(line)
    assert not all(map(is_plain, imports(tmp_path / "_kernels.py")))
