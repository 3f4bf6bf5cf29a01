"""A robot in a ROS graph: map service, agent, who plays the sensors and who listens, each a program of its own."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from splitslam.evaluate import Evaluation, evaluate
from splitslam.run.service import embedded_service
from splitslam.tum import Trajectory, read_tum
from tests.conftest import ROOT
from tests.ros.listen import READY

PYTHON = sys.executable
LAST_WORD = '"message": "stopped"'  # of the agent, in its diagnostics


@dataclass(frozen=True)
class LiveRun:
    """What is left of it. report: the agent's edge.json. played, heard: stdout of the player and of the listener."""

    out: Path
    report: dict[str, Any]
    played: str
    heard: str
    notes: str

    @property
    def online(self) -> Trajectory:
        return read_tum(self.out / "online.tum")

    def evaluation(self, truth: Path) -> Evaluation:
        return evaluate(self.online, read_tum(truth))


def live_run(
    folder: Path,
    agent: Mapping[str, Any],
    player: Sequence[str],
    listener: Sequence[str],
    environment: Mapping[str, str],
    of_player: Mapping[str, str] | None = None,
    timeout_s: float = 240.0,
) -> LiveRun:
    """The agent runs to its end (its source must have one); then the others are ended.

    agent: its configuration, less where the service is and where results go.
    environment: of our programs; of_player: of the player, when it is none of them.
    """
    with ExitStack() as stack:
        service_file = folder / "service.yaml"
        service = {"listen": "127.0.0.1:0", "store": f"sqlite:///{folder / 'map.db'}", "workers": 1}
        service_file.write_text(json.dumps(service | {"metrics": {"port": None}, "log": {"level": "warning"}}))
        served = stack.enter_context(embedded_service((PYTHON, "-m", "map_service"), service_file))
        values = {"server": served.address, "output": {"dir": str(folder / "out")}, "metrics": {"port": None}, **agent}
        (folder / "agent.yaml").write_text(json.dumps(values))
        command = [PYTHON, "-m", "edge_agent", "run", "--config", str(folder / "agent.yaml")]
        hearing = stack.enter_context(_Program(folder / "listener", listener, environment))
        hearing.wait_for(READY)
        playing = stack.enter_context(_Program(folder / "player", player, of_player or environment))
        running = stack.enter_context(_Program(folder / "agent", command, environment))
        running.wait(timeout_s, (playing, hearing))
        playing.wait(60.0)
        hearing.wait_until(lambda: LAST_WORD in hearing.said, f"hear {LAST_WORD!r}")
        hearing.process.terminate()
        hearing.wait(60.0)
    report = json.loads((folder / "out" / "edge.json").read_text())
    return LiveRun(folder / "out", report, playing.said, hearing.said, running.complained)


class _Program:
    """A process whose output goes to files: nobody reads along, and a full pipe would stop it."""

    def __init__(self, path: Path, command: Sequence[str], environment: Mapping[str, str]) -> None:
        self._path = path
        with self._file("out").open("w") as out, self._file("err").open("w") as err:
            self.process = subprocess.Popen(list(command), stdout=out, stderr=err, env=environment, cwd=ROOT)

    def __enter__(self) -> _Program:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.wait()

    def _file(self, kind: str) -> Path:
        return self._path.with_suffix(f".{kind}")

    @property
    def said(self) -> str:
        return self._file("out").read_text()

    @property
    def complained(self) -> str:
        return self._file("err").read_text()

    def check(self) -> bool:
        """True when it has ended, which must be a good end."""
        exit_code = self.process.poll()
        assert not exit_code, f"{self._path.name}: exit code {exit_code}: {self.complained[-2000:]}"
        return exit_code is not None

    def wait_for(self, word: str, timeout_s: float = 60.0) -> None:
        """Until it has said this on stderr."""
        self.wait_until(lambda: word in self.complained, f"say {word!r}", timeout_s)

    def wait_until(self, done: Callable[[], bool], what: str, timeout_s: float = 60.0) -> None:
        deadline_s = time.monotonic() + timeout_s
        while not done():
            in_vain = self.check() or time.monotonic() > deadline_s
            assert not in_vain, f"{self._path.name} does not {what}: {self.complained[-2000:]}"
            time.sleep(0.02)

    def wait(self, timeout_s: float, others: Sequence[_Program] = ()) -> None:
        """For its end; others: that must not fail meanwhile."""
        deadline_s = time.monotonic() + timeout_s
        while not self.check():
            assert time.monotonic() < deadline_s, f"{self._path.name} does not end: {self.complained[-2000:]}"
            for other in others:
                other.check()
            time.sleep(0.02)
