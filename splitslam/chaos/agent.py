"""A robot of the chaos runs: a real edge agent on a made drive, under a supervisor that starts it again."""

from __future__ import annotations

import json
import sys
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from splitslam.stack.process import StackProcess
from splitslam.tum import Trajectory, read_tum

PROGRAM = (sys.executable, "-m", "edge_agent")
_RESTART_S = 0.1  # systemd's RestartSec
_STOP_S = 5.0
_TICK_S = 0.05


@dataclass(frozen=True, slots=True)
class Drive:
    """A recording, its robot file and its truth (TUM): one pose at the reference time of each scan."""

    recording: Path
    robot: Path
    truth: Path


@dataclass(slots=True)
class Life:
    """One process of an agent. Times on the monotonic clock."""

    folder: Path
    pid: int
    began_s: float
    ended_s: float | None = None
    exit_code: int | None = None

    @property
    def report(self) -> dict[str, Any] | None:
        """edge.json, None of a life that was ended by force."""
        try:
            return json.loads((self.folder / "edge.json").read_text())
        except OSError:
            return None

    def trajectory(self, name: str) -> Trajectory | None:
        """A file it wrote, such as imu.tum; of a life ended by force what had reached the disk. None: nothing."""
        whole, part = self.folder / name, self.folder / f".{name}.part"
        if whole.exists():
            return read_tum(whole) if whole.stat().st_size else None
        lines = part.read_text().splitlines(keepends=True) if part.exists() else []
        torn = lines and not lines[-1].endswith("\n")
        kept = lines[:-1] if torn else lines
        if not kept:
            return None
        (clean := part.with_suffix(".kept")).write_text("".join(kept))
        return read_tum(clean)


class Agent:
    """One robot; `process` is what to kill or freeze. Every method may be called from any thread.

    began_s: when the first sensor message is due, monotonic clock: the sensors go on whether the agent lives or not.
    None: no clock, in lockstep, as fast as it goes. settings: what else agent.yaml holds. program: what
    `run --config FILE` is given to.
    """

    def __init__(
        self,
        name: str,
        drive: Drive,
        server: str,
        folder: Path,
        *,
        began_s: float | None = None,
        metrics_port: int | None = None,
        socket: Path | None = None,
        settings: dict[str, Any] | None = None,
        program: Sequence[str] = PROGRAM,
    ) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.name, self.drive, self.folder, self.began_s = name, drive, folder, began_s
        self.metrics_port, self.socket = metrics_port, socket
        self.lives: list[Life] = []
        self._server, self._settings, self._program = server, settings or {}, tuple(program)
        self.process = StackProcess(name, folder / "agent.log")
        self._stopping = threading.Event()
        self._beginning = threading.Lock()  # a life begins before a stop, which ends it, or not at all
        self._thread = threading.Thread(target=self._supervise, name=f"supervisor-{name}", daemon=True)

    def start(self) -> None:
        """Begins its first life."""
        robot = yaml.safe_load(self.drive.robot.read_text())
        robot["robot"] = {**robot.get("robot", {}), "id": self.name}
        (self.folder / "robot.yaml").write_text(yaml.safe_dump(robot))
        if self._begin():
            self._thread.start()

    @property
    def done(self) -> bool:
        """It has come to the end of its recording, or has given up."""
        return not self._thread.is_alive()

    @property
    def failure(self) -> str | None:
        """Why it gave up: the last line it said."""
        last = self.lives[-1] if self.lives else None
        if not self.done or last is None or last.exit_code == 0:
            return None
        return f"{self.name} ended with exit code {last.exit_code}: {self.process.last_line()}"

    def wait(self, timeout_s: float) -> bool:
        """True when it was done in time."""
        self._thread.join(timeout_s)
        return self.done

    def stop(self) -> None:
        """Ends it for good."""
        self._stopping.set()
        with self._beginning:
            self.process.stop(_STOP_S)
        if self._thread.is_alive():
            self._thread.join()

    # --- the supervisor ---------------------------------------------------------------------------------------

    def _begin(self) -> bool:
        """The next life; False when it shall have none."""
        folder = self.folder / f"life-{len(self.lives) + 1}"
        folder.mkdir()
        config = folder / "agent.yaml"
        config.write_text(yaml.safe_dump(self._config(folder)))
        with self._beginning:
            if self._stopping.is_set():
                return False
            self.process.launch((*self._program, "run", "--config", config))
            self.lives.append(Life(folder, self.process.pid, time.monotonic()))
        return True

    def _config(self, folder: Path) -> dict[str, Any]:
        by_the_clock = {"realtime": True, "began_s": self.began_s} if self.began_s is not None else {}
        return {
            "robot": str(self.folder / "robot.yaml"),
            "server": self._server,
            "source": {"recording": str(self.drive.recording), **by_the_clock},
            "output": {"dir": str(folder)},
            "state_dir": str(self.folder / "state"),
            "metrics": {"port": self.metrics_port},
            "feed": {"socket": None if self.socket is None else str(self.socket)},
            **self._settings,
        }

    def _supervise(self) -> None:
        while True:
            life = self.lives[-1]
            while (exit_code := self.process.exit_code) is None:
                time.sleep(_TICK_S)
            life.ended_s, life.exit_code = time.monotonic(), exit_code
            if exit_code >= 0 or self._stopping.wait(_RESTART_S):  # one that has ended by itself says why
                return
            if not self._begin():
                return
