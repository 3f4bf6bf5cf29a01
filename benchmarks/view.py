"""How the viewer keeps up: `python -m benchmarks.view BAG ROBOT.yaml [--robots 2] [--picture FILE.png]`.

A map service, robots that play a recording by the clock, `splitslam view --web`, and its page in headless Chromium
without a GPU. Printed: frames a second that the page drew, scans that were shown and missed, CPU time of each part.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from benchmarks.chromium import chromium
from splitslam.robot import load_robot
from splitslam.run.service import embedded_service

BIN = Path(sys.executable).parent
SIZE = 1600, 1000


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("bag", type=Path)
    parser.add_argument("robot", type=Path)
    parser.add_argument("--robots", type=int, default=2)
    parser.add_argument("--seconds", type=float, default=20.0, help="how long frames are counted")
    parser.add_argument("--after", type=float, default=20.0, help="seconds of driving before")
    parser.add_argument("--chromium", type=Path, default=Path(shutil.which("chromium") or "chromium"))
    parser.add_argument("--picture", type=Path)
    parser.add_argument("--voxel", default="0.1")
    asked = parser.parse_args(arguments)
    print(json.dumps(measure(asked), indent=1))


def measure(asked: argparse.Namespace) -> dict[str, Any]:
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="view-")))
        service = stack.enter_context(_service(folder))
        view = stack.enter_context(_view(service, asked.voxel))
        assert view.stdout is not None
        url = view.stdout.readline().strip()
        page = stack.enter_context(chromium(asked.chromium, SIZE))
        page.open(url)
        robots = [stack.enter_context(_robot(asked, service, folder, k)) for k in range(asked.robots)]
        time.sleep(asked.after)
        frames_s = page.frames_s(asked.seconds)
        if asked.picture is not None:
            page.save(asked.picture)
        view.terminate()
        assert view.stderr is not None
        said = view.stderr.read().strip().splitlines()
        for robot in robots:
            robot.terminate()
    gaps_s = np.diff(frames_s)
    return {
        "robots": asked.robots,
        "frames_per_s": round(len(gaps_s) / float(gaps_s.sum()), 1),
        "gap_ms": {
            q: round(float(np.percentile(gaps_s, p)) * 1e3) for q, p in (("p50", 50), ("p99", 99), ("max", 100))
        },
        "viewer": said[-1:],
    }


@contextmanager
def _service(folder: Path) -> Iterator[str]:
    path = folder / "map.yaml"
    store = f"sqlite:///{folder / 'map.db'}"
    path.write_text(yaml.safe_dump({"listen": "127.0.0.1:0", "store": store, "workers": 1, "metrics": {"port": None}}))
    with embedded_service((sys.executable, "-m", "map_service"), path) as service:
        yield service.address


@contextmanager
def _started(command: Sequence[str], **options: Any) -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen(command, text=True, **options)
    try:
        yield process
    finally:
        process.terminate()
        process.wait(20)


def _view(service: str, voxel: str) -> Any:
    command = (str(BIN / "splitslam"), "view", service, "--web", "--voxel", voxel)
    return _started(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)


def _robot(asked: argparse.Namespace, service: str, folder: Path, number: int) -> Any:
    """The same recording under another name."""
    robot = yaml.safe_load(asked.robot.read_text())
    robot["robot"] = {"id": f"{load_robot(asked.robot).robot.id}-{number + 1}"}
    path = folder / f"robot-{number}.yaml"
    path.write_text(yaml.safe_dump(robot))
    out = folder / f"out-{number}"
    options = ("--robot", str(path), "--out", str(out), "--server", service, "--realtime")
    command = (str(BIN / "splitslam"), "run", str(asked.bag), *options)
    return _started(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


if __name__ == "__main__":
    main()
