"""How long robots go without an answer when a plug of the stack is pulled: real processes, one fault after another.

    python -m benchmarks.gaps RECORDING ROBOT --robots 4

A gap is the longest time between two answers to a robot that sends at 10 Hz, so 100 ms is none. Prints one JSON object:
by fault the largest and the median gap of all robots, s, scans lost, and the load of the machine then.
"""

from __future__ import annotations

import json
import os
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from benchmarks.command import run
from splitslam.stack import Replica, Stack
from splitslam.stack.reel import record
from splitslam.stack.robot import LightRobot

BEFORE_S, AFTER_S = 15.0, 3.0
FROZEN_S, AWAY_S = 6.0, 3.0

app = typer.Typer(add_completion=False)


class Plugs:
    """Each method is one fault of a running stack; `mend` brings everything up again."""

    def __init__(self, stack: Stack) -> None:
        self._stack = stack

    def nothing(self) -> None:
        time.sleep(AFTER_S)

    def replica_killed(self) -> None:
        self._fullest().kill()

    def replica_drained(self) -> None:
        self._fullest().drain()

    def replica_frozen(self) -> None:
        replica = self._fullest()
        replica.freeze()
        time.sleep(FROZEN_S)
        replica.thaw()

    def store_killed(self) -> None:
        assert self._stack.postgres is not None
        self._stack.postgres.kill()
        time.sleep(AWAY_S)
        self._stack.postgres.start()

    def proxy_killed(self) -> None:
        self._stack.envoy.kill()
        self._stack.envoy.start()

    def mend(self) -> None:
        for replica in self._stack.replicas:
            if not replica.alive:
                replica.start()
        self._stack.wait_healthy()

    def _fullest(self) -> Replica:
        return max(self._stack.replicas, key=lambda replica: replica.metrics()["splitslam_map_streams"])

    def all(self) -> dict[str, Callable[[], None]]:
        faults = (self.nothing, self.replica_killed, self.replica_drained, self.replica_frozen)
        return {fault.__name__: fault for fault in (*faults, self.store_killed, self.proxy_killed)}


def measure(pull: Callable[[], None], robots: list[LightRobot]) -> dict[str, Any]:
    """{max_s, median_s, lost, load}. Raises StackError when a robot does not go on."""
    for robot in robots:
        robot.start()
    time.sleep(BEFORE_S)
    since_s = time.monotonic()
    pull()
    time.sleep(AFTER_S)
    for robot in robots:
        robot.wait_answers(robot.sent)
    waited = [robot.gap_s(since_s) for robot in robots]
    lost = sum(-robot.finish().mapped + robot.sent for robot in robots)  # in this order: it may send until then
    return {"max_s": max(waited), "median_s": statistics.median(waited), "lost": lost, "load": os.getloadavg()[0]}


@app.command()
def main(
    recording: Annotated[Path, typer.Argument(metavar="RECORDING", help="30 s of it are played.")],
    robot: Annotated[Path, typer.Argument(metavar="ROBOT", help="Its robot file.")],
    robots: Annotated[int, typer.Option(min=1, help="How many play it at once.")] = 4,
    replicas: Annotated[int, typer.Option(min=2, help="Of the map service, one worker each.")] = 3,
) -> None:
    """Gaps between answers, by fault."""
    reel, gaps = record(recording, robot, max_scans=300), {}
    with tempfile.TemporaryDirectory() as folder, Stack(Path(folder), replicas=replicas) as stack:
        plugs = Plugs(stack)
        for name, pull in plugs.all().items():
            fleet = [LightRobot(stack.address, reel, f"robot-{i}") for i in range(robots)]
            gaps[name] = measure(pull, fleet)
            plugs.mend()
    print(json.dumps({"robots": robots, "replicas": replicas, "gaps": gaps}, indent=2))


if __name__ == "__main__":
    run(app)
