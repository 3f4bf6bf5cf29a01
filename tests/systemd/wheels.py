"""Wheels of this checkout, and kernels that its tests have compiled already."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

from numba.core.caching import _CacheLocator

from tests.conftest import ROOT

PACKAGES = ("edge_agent", "map_service", "splitslam", "fpga_overlay/golden", "fpga_overlay/driver")


def build_wheel(folder: Path, version: str) -> Path:
    """The checkout as a wheel that calls itself `version`."""
    source = folder / f"source-{version}"
    ignored = shutil.ignore_patterns("__pycache__", "tests")
    for package in PACKAGES:
        shutil.copytree(ROOT / package, source / package, ignore=ignored)
    for name in ("README.md", "LICENSE", "fpga_overlay/__init__.py"):
        shutil.copy(ROOT / name, source / name)
    for name, line in (("pyproject.toml", 'version = "{}"'), ("splitslam/__init__.py", '__version__ = "{}"')):
        pattern = re.compile(f"^{line.partition(' ')[0]} = .*$", re.MULTILINE)
        text, found = pattern.subn(line.format(version), (ROOT / name).read_text())
        assert found == 1
        (source / name).write_text(text)
    command = [sys.executable, "-m", "pip", "wheel", "-qq", "--no-index", "--no-deps", "--no-build-isolation"]
    built = subprocess.run([*command, "-w", str(folder), str(source)], capture_output=True, text=True, timeout=200)
    assert built.returncode == 0, built.stderr[-2000:]
    return folder / f"splitslam-{version}-py3-none-any.whl"


def borrow_kernels(installed: Path, cache: Path) -> int:
    """Copies what this checkout has compiled to where an installed version looks; the source is the same.

    numba keeps kernels by a hash of their source file. Returns how many files there were.
    """
    (site,) = installed.glob("lib/python3.*/site-packages")
    copied = 0
    for package in PACKAGES:
        for kernels in (ROOT / package).rglob("__pycache__"):
            beside = site / kernels.parent.relative_to(ROOT)
            target = cache / _CacheLocator.get_suitable_cache_subpath(str(beside / "any.py"))
            for file in (*kernels.glob("*.nbi"), *kernels.glob("*.nbc")):
                target.mkdir(parents=True, exist_ok=True)
                shutil.copy(file, target)
                copied += 1
    return copied
