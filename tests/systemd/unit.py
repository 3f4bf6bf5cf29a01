"""A unit file with its drop-ins, as far as running what it says outside systemd takes."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.conftest import ROOT
from tests.systemd.tools import debian

UNITS = ROOT / "deploy" / "systemd"
INSTALLED = "/opt/splitslam"


@dataclass(frozen=True)
class Unit:
    """values: (key, value) of [Service] in order; an empty value takes back those before."""

    values: tuple[tuple[str, str], ...]

    def all(self, key: str) -> list[str]:
        found: list[str] = []
        for name, value in self.values:
            if name == key:
                found = [*found, value] if value else []
        return found

    def one(self, key: str) -> str:
        return self.all(key)[-1]

    @property
    def environment(self) -> dict[str, str]:
        words = [word for line in self.all("Environment") for word in shlex.split(line)]
        return dict(word.split("=", 1) for word in words)

    def seconds(self, key: str) -> float:
        return float(self.one(key))


def read_unit(*files: Path) -> Unit:
    """The unit and, after it, its drop-ins."""
    values: list[tuple[str, str]] = []
    for file in files:
        section = ""
        for line in file.read_text().splitlines():
            if line.startswith("["):
                section = line.strip("[]")
            elif section == "Service" and re.match(r"\w+=", line):
                key, _, value = line.partition("=")
                values.append((key, value))
    return Unit(tuple(values))


def placed(name: str, folder: Path, executables: Path, drop_ins: Sequence[str] = ()) -> Path:
    """A copy of the unit in `folder` that starts what is in `executables`, with these drop-ins beside it."""
    unit = folder / name
    text = (UNITS / name).read_text()
    assert f"{INSTALLED}/current/bin" in text
    unit.write_text(text.replace(f"{INSTALLED}/current/bin", str(executables)))
    beside = folder / f"{name}.d"
    shutil.rmtree(beside, ignore_errors=True)
    for drop_in in drop_ins:
        beside.mkdir(exist_ok=True)
        shutil.copy(UNITS / f"{name}.d" / drop_in, beside)
    return unit


def analyze(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    """systemd-analyze, from Debian where it is missing and we are root."""
    command = [debian("systemd-analyze", "systemd"), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=60)


def exposure(unit: Path) -> float:
    done = analyze("security", "--offline=true", "--no-pager", unit)
    found = re.search(r"Overall exposure level for \S+: ([0-9.]+)", done.stdout)
    if found is None:
        pytest.fail(f"systemd-analyze says no exposure: {done.stdout}{done.stderr}")
    return float(found[1])
