"""Programs from Debian's archive without root: found on the PATH, or fetched into a cache folder of this checkout."""

from __future__ import annotations

import fcntl
import os
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

from tests.conftest import ROOT
from tests.missing import missing

CACHE = ROOT / "build" / "debian"
_FETCH_S = 240


def unpacked(*packages: str, with_needs: bool = False) -> Path:
    """A folder as `/`, with these packages in it, and with_needs: all that they need and this machine has not.

    Fetched once, whoever asks; where they cannot be fetched a test is skipped on a laptop and fails in CI.
    """
    folder = CACHE / packages[0]
    CACHE.mkdir(parents=True, exist_ok=True)
    with (CACHE / "lock").open("w") as lock:  # several test processes want it at once
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (folder / ".unpacked").exists() and (problem := _fetch(folder, packages, with_needs)):
            missing(f"Debian's {', '.join(packages)} cannot be fetched: {problem}")
    return folder


def binary(name: str, package: str) -> Path:
    """The program on the PATH, else out of the package."""
    found = shutil.which(name)
    return Path(found) if found else unpacked(package) / "usr" / "bin" / name


def chromium() -> tuple[Path, dict[str, str]]:
    """The browser, and what it needs in its environment where it is not installed. Root installs it."""
    if os.getuid() == 0 and shutil.which("chromium") is None and shutil.which("apt-get"):
        _install("chromium")
    if found := shutil.which("chromium"):
        return Path(found), {}
    root = unpacked("chromium", with_needs=True)
    libraries = sorted({str(path.parent) for path in root.glob("usr/lib/**/*.so*")})
    return root / "usr/lib/chromium/chromium", {
        "LD_LIBRARY_PATH": ":".join([str(root / "usr/lib/chromium"), *libraries]),
        "FONTCONFIG_PATH": str(root / "etc/fonts"),
    }


def _install(package: str) -> None:
    """With all that it needs, as root; whether that went well is seen by who looks for the program."""
    CACHE.mkdir(parents=True, exist_ok=True)
    with (CACHE / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        _run(CACHE, "apt-get", "update", "-qq")
        _run(CACHE, "apt-get", "install", "-y", "-qq", "--no-install-recommends", package)


def _fetch(folder: Path, packages: Sequence[str], with_needs: bool) -> str | None:
    """Why they are not there now, or None."""
    if not (shutil.which("apt-get") and shutil.which("dpkg")):
        return "apt-get and dpkg are needed"
    folder.mkdir(exist_ok=True)
    problem = _download(folder, packages, with_needs)
    if problem is not None:  # no package lists, or old ones: ours are as good, and need no root
        lists, archives = CACHE / "lists", CACHE / "archives"
        for made in (lists, archives):
            (made / "partial").mkdir(parents=True, exist_ok=True)
        ours = [f"-oDir::State::Lists={lists}", f"-oDir::Cache={archives}", "-oAPT::Sandbox::User="]
        problem = _run(folder, "apt-get", *ours, "update") or _download(folder, packages, with_needs, ours)
    for archive in sorted(folder.glob("*.deb")):
        problem = problem or _run(folder, "dpkg", "-x", str(archive), str(folder))
        archive.unlink()
    if problem is None:
        (folder / ".unpacked").touch()
    return problem


def _download(folder: Path, packages: Sequence[str], with_needs: bool, options: Sequence[str] = ()) -> str | None:
    if with_needs:
        asked = ["apt-get", *options, "install", "--simulate", "--no-install-recommends", *packages]
        done = subprocess.run(asked, capture_output=True, text=True, timeout=_FETCH_S)
        needed = [line.split()[1] for line in done.stdout.splitlines() if line.startswith("Inst ")]
        if done.returncode or not needed:
            return done.stderr.strip() or "nothing to install"
        packages = needed
    return _run(folder, "apt-get", *options, "download", *packages)


def _run(folder: Path, *command: str) -> str | None:
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=_FETCH_S)
    lines = [line for line in done.stderr.splitlines() if line.startswith("E:")] or [done.stderr.strip()]
    return (lines[-1] or f"{command[0]} failed") if done.returncode else None
