"""ROS 2 for a test: rclpy with Fast DDS as PyPI's wheels have it, in this checkout's cache; no ROS installation."""

from __future__ import annotations

import fcntl
import subprocess
import sys
from pathlib import Path

from tests.debian import CACHE
from tests.missing import missing

WHEELS = Path(__file__).with_name("ros2_wheels.txt")
_FETCH_S = 240


def environment() -> dict[str, str]:
    """Of a program that shall find rclpy. Fetched once, whoever asks; skipped on a laptop where that fails."""
    folder = CACHE.parent / "ros2"
    CACHE.mkdir(parents=True, exist_ok=True)
    with (CACHE / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (folder / ".installed").exists() and (problem := _install(folder)):
            missing(f"the wheels of {WHEELS.name} cannot be installed: {problem}")
    (packages,) = folder.glob("lib/python3*/site-packages")
    return {
        "PYTHONPATH": str(packages),
        "LD_LIBRARY_PATH": ":".join([str(folder / "lib"), *sorted(map(str, packages.glob("ros_*.libs")))]),
        "AMENT_PREFIX_PATH": str(folder),
        "RMW_IMPLEMENTATION": "rmw_fastrtps_cpp",
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_LOG_DIR": str(folder / "log"),
    }


def _install(folder: Path) -> str | None:
    """Why it cannot be, or None. Without what wheels need only to be built."""
    command = [
        sys.executable,
        "-m",
        "pip",
        "install",
        "--quiet",
        "--no-deps",
        "--only-binary=:all:",
        "--no-binary=empy",
    ]
    command += ["--disable-pip-version-check", "--ignore-installed", "--prefix", str(folder), "-r", str(WHEELS)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=_FETCH_S)
    if done.returncode:
        return (done.stderr.strip().splitlines() or ["pip failed"])[-1]
    (folder / ".installed").touch()
    return None
