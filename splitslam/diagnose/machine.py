"""Versions and the machine; logs where systemd keeps them."""

from __future__ import annotations

import contextlib
import importlib.metadata
import os
import platform
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

_ASK_S = 20.0
_LOG_LINES = 20_000
_LOG_BYTES = 8 * 2**20


def versions() -> dict[str, Any]:
    """Of us, Python, the kernel and every package here."""
    packages = {d.name: d.version for d in importlib.metadata.distributions()}
    return {
        "splitslam": packages.get("splitslam"),
        "python": sys.version,
        "executable": sys.executable,
        "machine": platform.machine(),
        "processor": _processor(),
        "cores": os.cpu_count(),
        "kernel": platform.release(),
        "system": platform.freedesktop_os_release().get("PRETTY_NAME") if Path("/etc/os-release").exists() else None,
        "packages": dict(sorted(packages.items(), key=lambda item: item[0].lower())),
    }


def _processor() -> str | None:
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    names = (line.partition(":")[2].strip() for line in lines if line.lower().startswith(("model name", "cpu part")))
    return next(names, None)


def ask(*command: str) -> str | None:
    """What a program says; None when there is none, or it fails."""
    if shutil.which(command[0]) is None:
        return None
    try:
        done = subprocess.run(command, capture_output=True, text=True, errors="replace", timeout=_ASK_S)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout if done.returncode == 0 else None


def journal(unit: str) -> str | None:
    """The last lines of a unit's log."""
    limits = ("--no-pager", "--quiet", "--output=short-iso-precise", f"--lines={_LOG_LINES}")
    return ask("journalctl", f"--unit={unit}", *limits) or None


def tail(path: Path) -> str:
    """The end of a log file. Raises OSError."""
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - _LOG_BYTES))
        return file.read().decode(errors="replace")


def unit_state(unit: str) -> str | None:
    """What systemd knows of it: state, restarts, how it ended, its environment."""
    return ask("systemctl", "show", "--no-pager", unit)


def unit_environment(unit: str) -> dict[str, str]:
    """The variables that a unit gives its service, by Environment= and EnvironmentFile=, also of a dead one."""
    words: list[str] = []
    for line in (unit_state(unit) or "").splitlines():
        key, _, value = line.partition("=")
        if key == "Environment":
            words += shlex.split(value)
        elif key == "EnvironmentFiles":
            with contextlib.suppress(OSError, ValueError):  # not there, or not for us
                words += shlex.split(Path(value.rpartition(" (")[0]).read_text(), comments=True)
    return dict(word.split("=", 1) for word in words if "=" in word)
