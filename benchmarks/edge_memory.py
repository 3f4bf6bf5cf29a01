"""Memory of the edge agent over minutes of recording: `python -m benchmarks.edge_memory --help`.

A recording, and then a part of it over and over, goes through the agent as it is installed, as fast as it goes, with a
map service in a process of its own. The part should end where it begins: at its seam the robot stands elsewhere at
once. Nothing is kept for a report, as on a robot.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

if __package__ in (None, ""):  # run as a file
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.command import run
from edge_agent import daemon
from edge_agent.config import AgentConfig
from edge_agent.metrics import EdgeMetrics
from edge_agent.sources import Event, Source, open_recording
from edge_agent.sources.time_map import shifted
from map_service.processes import resident_bytes
from splitslam import config
from splitslam.errors import InputError
from splitslam.robot import Robot
from splitslam.run.configs import configs
from splitslam.run.options import RunOptions
from splitslam.run.orchestrate import PROGRAMS
from splitslam.run.service import embedded_service
from splitslam.scan import Scan

BARS = {"rss_mb": 320.0, "growth_mb_a_minute": 1.0}
_SCAN_NS = 100_000_000
_EVERY_SCANS = 50
_SETTLED_S = 120.0  # by then all that is made once is there

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


class Laps:
    """A recording up to `end_s`, then from `begin_s` to `end_s` again and again, with stamps that go on.

    Says how much memory the process has after every 50th scan.
    """

    def __init__(self, path: Path, robot: Robot, minutes: float, begin_s: float, end_s: float) -> None:
        self._path, self._last_ns = path, round(minutes * 60e9)
        self._begin_ns, self._end_ns = round(begin_s * 1e9), round(end_s * 1e9)
        self._first = open_recording(path, robot)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._first, name)

    def events(self) -> Iterator[tuple[int, Event]]:
        """See Recording.events; until so much time has passed."""
        scans = 0
        for shift_ns, arrival_ns, event in self._shifted():
            passed_ns = arrival_ns + shift_ns - self._first.start_ns
            if passed_ns > self._last_ns:
                return
            if isinstance(event, Scan):
                scans += 1
                if scans % _EVERY_SCANS == 0:
                    print(json.dumps([round(passed_ns * 1e-9, 1), resident_bytes() / 1e6]), flush=True)
            yield arrival_ns + shift_ns, shifted(event, shift_ns)

    def _shifted(self) -> Iterator[tuple[int, int, Event]]:
        recording, shift_ns = self._first, 0
        while True:
            for arrival_ns, event in recording.events():
                at_ns = arrival_ns - self._first.start_ns
                if at_ns > self._end_ns:
                    break
                if shift_ns == 0 or at_ns >= self._begin_ns:
                    yield shift_ns, arrival_ns, event
            recording.close()
            shift_ns += min(self._end_ns, recording.end_ns - recording.start_ns) - self._begin_ns + _SCAN_NS
            recording = open_recording(self._path, self._first.robot)


def play(agent: Path, minutes: float, begin_s: float, end_s: float) -> None:
    """In a process of its own: the agent with its configuration, on a recording that does not end before."""

    def laps(config: AgentConfig, robot: Robot, metrics: EdgeMetrics, stop: threading.Event) -> Source:
        recording = config.source.recording
        assert recording is not None
        return Laps(recording, robot, minutes, begin_s, end_s)  # pyright: ignore[reportReturnType]

    daemon.open_source = laps
    daemon.run_agent(config.load(AgentConfig, agent), threading.Event())


def verdict(samples: list[tuple[float, float]]) -> dict[str, float]:
    """samples: recording time s and resident MB. Largest in the last minute, and the slope once all is settled."""
    t_s, rss_mb = np.array(samples).T
    settled = t_s > min(_SETTLED_S, 0.5 * t_s[-1])
    slope = np.polyfit(t_s[settled] / 60.0, rss_mb[settled], 1)[0] if settled.sum() > 1 else float("nan")
    return {"rss_mb": float(rss_mb[t_s > t_s[-1] - 60.0].max()), "growth_mb_a_minute": float(slope)}


@app.command()
def main(
    recording: Annotated[Path, typer.Argument(help="A bag, its robot file beside it.")],
    minutes: Annotated[float, typer.Option(min=0.1, help="Of recording time.")] = 10.0,
    begin: Annotated[float, typer.Option(min=0, help="Of the part that is repeated, s.")] = 0.0,
    end: Annotated[float, typer.Option(help="Its end, s.")] = 1e6,
    out: Annotated[Path | None, typer.Option(help="JSON of all samples.")] = None,
    check: Annotated[bool, typer.Option("--check", help="Exit code 1 when a bar is missed.")] = False,
    child: Annotated[Path | None, typer.Option(hidden=True)] = None,
) -> None:
    """Plays RECORDING for so many minutes and prints how much memory the agent has, and by how much it grows."""
    if child is not None:
        play(child, minutes, begin, end)
        return
    with tempfile.TemporaryDirectory(prefix="edge-memory-") as folder:
        samples = _played(recording, ("--minutes", minutes, "--begin", begin, "--end", end), Path(folder))
    found = verdict(samples)
    result = {"recording": str(recording), "minutes": minutes, **found, "bars": BARS, "load": os.getloadavg()[0]}
    if out is not None:
        out.write_text(json.dumps({**result, "samples": samples}, indent=1) + "\n")
    print(json.dumps(result))
    if check and any(found[name] > bar for name, bar in BARS.items()):
        sys.exit(1)


def _played(recording: Path, part: tuple[str | float, ...], work: Path) -> list[tuple[float, float]]:
    agent, service = configs(RunOptions(recording, recording.with_suffix(".yaml"), work / "out"), work)
    service_file, agent_file = work / "map.yaml", work / "agent.yaml"
    service_file.write_text(config.dump(service))
    with embedded_service(PROGRAMS.map_service, service_file) as running:
        quiet = agent.output.model_copy(update={"dir": None, "progress": False})
        agent_file.write_text(config.dump(agent.model_copy(update={"server": running.address, "output": quiet})))
        command = [sys.executable, "-m", "benchmarks.edge_memory", str(recording), *map(str, part)]
        done = subprocess.run([*command, "--child", str(agent_file)], stdout=subprocess.PIPE, text=True, check=False)
    samples = [tuple(json.loads(line)) for line in done.stdout.splitlines() if line.startswith("[")]
    if done.returncode or not samples:
        raise InputError(
            f"{recording}: the agent ended with {done.returncode} after {len(samples)} looks at its memory"
        )
    return samples


if __name__ == "__main__":
    run(app)
