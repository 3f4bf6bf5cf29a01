"""Agents and services of this release and of the one before, each with each: `python -m benchmarks.versions --help`.

The release before is the wheel in tests/versions. Lockstep: figures do not depend on the machine.
"""

from __future__ import annotations

import json
import sys
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import typer

if __package__ in (None, ""):  # run as a file
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.command import run
from benchmarks.peers import ROOT
from splitslam import __version__
from splitslam.evaluate import evaluate
from splitslam.tum import read_tum
from tests.versions import previous
from tests.versions.mixed import NEW_AGENT, NEW_SERVICE, Service, robot, sessions_of, trajectory_of

app = typer.Typer(add_completion=False)
YARD1 = ROOT.parent / "shared" / "data" / "yard1" / "yard1.bag"


@dataclass(frozen=True, slots=True)
class Meeting:
    """One run. lost: scans that were read and are not in the map."""

    agent: str
    service: str
    scans: int
    lost: int
    ate_mm: float
    online_ate_mm: float
    kbps: float

    def row(self) -> str:
        scans = f"{self.scans - self.lost} of {self.scans}"
        ates = f"{self.ate_mm:.1f} / {self.online_ate_mm:.1f} mm"
        return f"| {self.agent} | {self.service} | {scans} | {ates} | {self.kbps:.0f} kbit/s |"


@app.command()
def main(
    recording: Annotated[Path, typer.Argument(metavar="BAG", help="Robot file and truth lie beside it.")] = YARD1,
    max_scans: Annotated[int | None, typer.Option(min=2, help="Only so many.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")] = False,
) -> None:
    """Every scan must be mapped, whoever meets whom."""
    agents = {__version__: NEW_AGENT, previous.VERSION: previous.command("edge_agent")}
    services = {__version__: NEW_SERVICE, previous.VERSION: previous.command("map_service")}
    meetings = []
    for agent in agents:
        for service in services:
            with tempfile.TemporaryDirectory() as folder:
                programs = agents[agent], services[service]
                meetings.append(meet(agent, service, programs, recording, max_scans, Path(folder)))
            if not as_json:
                print(meetings[-1].row(), flush=True)
    if as_json:
        print(json.dumps([asdict(meeting) for meeting in meetings]))


def meet(
    agent: str,
    service: str,
    programs: tuple[tuple[str, ...], ...],
    recording: Path,
    max_scans: int | None,
    folder: Path,
) -> Meeting:
    """One agent's run at one service, both of any release."""
    running = Service(programs[1], folder / "map.db", folder / "service.log")
    try:
        running.wait_ready()
        robot("robot", programs[0], recording, f"127.0.0.1:{running.target[1]}", folder, max_scans).wait_end(600.0)
        (session,) = sessions_of(running.target).values()
        mapped = trajectory_of(running.target, session, folder / "trajectory.tum")
    finally:
        running.close()
    report = json.loads((folder / "robot" / "edge.json").read_text())
    truth = read_tum(recording.with_suffix(".tum"))
    ate, online = (
        evaluate(read_tum(path), truth).ate_m * 1e3
        for path in (folder / "trajectory.tum", folder / "robot" / "online.tum")
    )
    read = report["scans"]["read"]
    return Meeting(agent, service, read, read - len(set(mapped)), ate, online, report["uplink"]["kbps"])


if __name__ == "__main__":
    run(app)
