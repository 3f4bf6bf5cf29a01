"""docs/quick_start.md, typed from top to bottom as a newcomer would, with shorter drives and on free ports."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path
from typing import Self

import pytest

from splitslam.robot import load_robot
from splitslam.stack.process import free_port
from splitslam.tum import read_tum
from tests.conftest import ROOT
from tests.docs.pages import shell_lines

PAGE = "docs/quick_start.md"
TEXT = (ROOT / PAGE).read_text()
YAMLS = dict(re.findall(r"^```yaml\n# (\S+\.yaml)\n(.*?)^```", TEXT, re.MULTILINE | re.DOTALL))
# The same in less time, or without somebody at the keys; `make demo` is made sure of below.
INSTEAD = {
    "make demo": "splitslam demo --seconds 12",
    "splitslam top": "splitslam top --json",
    "splitslam demo --chaos": "splitslam demo --chaos --seconds 10 --script pull --json",
}
LIST = "map-service sessions list --config service.yaml"
MAPPED = 120  # scans of the drive
WITHIN_S = 200


class Newcomer:
    """Somebody with a shell in a folder that holds nothing but `.venv`."""

    def __init__(self, folder: Path, **environment: str) -> None:
        self._folder = folder
        self._environment = {key: value for key, value in os.environ.items() if not key.startswith("SPLITSLAM_")}
        self._environment |= {"PATH": f"{sys.prefix}/bin:{os.environ['PATH']}", **environment}
        self._running: list[subprocess.Popen[str]] = []

    def types(self, line: str) -> str:
        """What a command prints on stdout, once it has ended well."""
        done = subprocess.run(
            ("bash", "-euc", line), cwd=self._folder, env=self._environment, capture_output=True, text=True,
            timeout=WITHIN_S,
        )  # fmt: skip
        assert done.returncode == 0, f"{line}\n{done.stdout[-2000:]}{done.stderr[-2000:]}"
        return done.stdout

    def starts(self, line: str) -> subprocess.Popen[str]:
        """A command that stays."""
        process = subprocess.Popen(
            ("bash", "-euc", f"exec {line}"), cwd=self._folder, env=self._environment, stdout=subprocess.PIPE, text=True
        )
        self._running.append(process)
        return process

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Ctrl-C in every terminal that is left."""
        for process in self._running:
            process.send_signal(signal.SIGINT)  # nothing where it has ended
        for process in self._running:
            assert process.stdout is not None
            process.stdout.close()
            assert process.wait(60) == 0


def test_every_command_of_the_page_works_in_its_order(tmp_path: Path) -> None:
    grpc, service, agent = (free_port() for _ in range(3))
    ports = {"SPLITSLAM_MAP__METRICS__PORT": str(service), "SPLITSLAM_EDGE__METRICS__PORT": str(agent)}
    (tmp_path / ".venv").symlink_to(sys.prefix)
    (tmp_path / "pull").write_text("2 kill replica\n")
    for name, text in YAMLS.items():
        (tmp_path / name).write_text(text.replace("50051", str(grpc)).replace("0.0.0.0", "127.0.0.1"))
    with Newcomer(tmp_path, **ports) as newcomer:
        said = _typed(newcomer, f"127.0.0.1:{agent} 127.0.0.1:{service}")

    _what_the_tables_say_is_there(tmp_path / "out/demo")
    for folder in ("mine", "map"):
        assert (tmp_path / "out" / folder / "map.ply").stat().st_size > 100_000
    assert len(read_tum(tmp_path / "out/mine/trajectory.tum")) == MAPPED
    found = re.search(r"^demo/\S+  north  finished  (\d+) frames", said[LIST])
    assert found, said[LIST]
    assert MAPPED // 2 < int(found[1]) <= MAPPED  # by the clock: a busy machine drops scans, and says so
    assert len(read_tum(tmp_path / "out/map/trajectory.tum")) == int(found[1])
    pulled = json.loads(said["splitslam demo --chaos"])
    (fault,) = pulled["faults"]
    assert re.fullmatch(r"replica-\d killed", fault["fault"])
    assert [(robot["lost"], robot["twice"]) for robot in pulled["robots"]] == [(0, 0)] * 4


def _typed(newcomer: Newcomer, endpoints: str) -> dict[str, str]:
    """What each line of the page has printed. endpoints: where both programs have their metrics."""
    said = {line.text: "" for line in shell_lines(PAGE, TEXT)}
    agent = None
    for line in said:
        if line.startswith("map-service serve"):
            assert "listening" in _line(newcomer.starts(line))
        elif line.startswith("edge-agent run"):
            agent = newcomer.starts(line)
        elif line == "splitslam top":
            assert agent is not None
            said[line] = _until_mapped(newcomer, f"{INSTEAD[line]} {endpoints}", agent)
            assert agent.wait(60) == 0
        else:
            listed = said.get(LIST, "").partition(" ")[0]
            said[line] = newcomer.types(INSTEAD.get(line, line).replace("ROBOT/RUN", listed))
    return said


def _line(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    return process.stdout.readline()


def _until_mapped(newcomer: Newcomer, top: str, agent: subprocess.Popen[str]) -> str:
    """What `top` shows once both are there and the robot is being mapped."""
    while agent.poll() is None:
        try:
            shown = newcomer.types(top)
        except AssertionError:  # the agent does not serve its metrics yet
            continue
        if '"tracking"' in shown:
            return shown
    pytest.fail("the recording was over before the robot was seen as tracking")


def _what_the_tables_say_is_there(folder: Path) -> None:
    section = TEXT[TEXT.index("## A map\n") : TEXT.index("## A recording")]
    named = [
        name
        for row in re.findall(r"^\| (.*) \|$", section, re.MULTILINE)
        for name in re.findall(r"`([^`]+\.\w+)`", row)
    ]
    assert len(named) > 5
    assert not [name for name in named if not (folder / name).is_file()]


def test_make_demo_is_the_demo() -> None:
    shown = subprocess.run(
        ("make", "--no-print-directory", "--dry-run", "demo"), cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout
    assert shown.splitlines()[-1].split() == [".venv/bin/splitslam", "demo"]


def test_the_robot_file_of_the_page_is_one(tmp_path: Path) -> None:
    (tmp_path / "robot.yaml").write_text(YAMLS["robot.yaml"])
    robot = load_robot(tmp_path / "robot.yaml")
    assert (robot.lidar.rings, robot.imu is not None) == (16, True)
