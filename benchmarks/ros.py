"""`python -m benchmarks.ros [--seconds S] [--only dds,dds-best-effort,ros1]`: yard1 through ROS at its own pace.

Each way: who plays, the agent, the map service and a listener, each a process of its own, on loopback. Prints a table:
scans that were played, mapped and lost, ATE of the answers, what a scan costs the agent.
ROS 1 comes from Debian's packages (tests/ros/ros1.py).
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.drives import data_folder
from tests.ros.dds import DOMAIN, cyclonedds_uri
from tests.ros.live_run import PYTHON, LiveRun, live_run
from tests.ros.ros1 import plain_copy, roscore

BAG = data_folder() / "yard1" / "yard1.bag"
TRUTH = BAG.with_suffix(".tum")
END_S = 2.0


@dataclass(frozen=True)
class Through:
    """One way: what came out of it."""

    name: str
    played: int
    run: LiveRun

    def row(self) -> str:
        report, ate = self.run.report, self.run.evaluation(TRUTH)
        scans, cpu = report["scans"], report["cpu_ms_per_scan"]
        lost = {reason: count for reason, count in report["dropped_by_reason"].items() if count}
        return (
            f"| {self.name} | {self.played} | {scans['mapped']} | {self.played - scans['mapped']} |"
            f" {1e3 * ate.ate_m:.1f} mm | {cpu['edge']:.1f} ms, {cpu['reader']:.1f} ms | {lost or 'none'} |"
        )


def over_dds(folder: Path, seconds: float, offered: str) -> Through:
    graph = {"via": "cyclonedds", "domain_id": DOMAIN}
    player = [PYTHON, "-m", "tests.ros.play_dds", str(BAG), str(seconds), str(DOMAIN), offered]
    listener = [PYTHON, "-m", "tests.ros.listen", "ros2", json.dumps(graph)]
    environment = os.environ | {"CYCLONEDDS_URI": cyclonedds_uri()}
    agent = _agent({"ros2": graph | {"end_after_s": END_S}})
    run = live_run(folder, agent, player, listener, environment, timeout_s=seconds + 120)
    return Through(f"ROS 2, CycloneDDS, {offered}", json.loads(run.played)["/velodyne_packets"], run)


def through_ros1(folder: Path, seconds: float) -> Through:
    copy = folder / "yard1.bag"
    played = plain_copy(BAG, copy, seconds)
    with roscore(folder) as ros:
        graph = {"master": ros.uri, "python_path": ros.python_path}
        listener = [PYTHON, "-m", "tests.ros.listen", "ros1", json.dumps(graph | {"node": "listener"})]
        agent = _agent({"ros1": graph | {"end_after_s": END_S}})
        run = live_run(
            folder, agent, ros.rosbag_play(copy), listener, ros.ours, ros.environment, timeout_s=seconds + 120
        )
    return Through("ROS 1, roscore and rosbag play", played, run)


def _agent(source: dict[str, Any]) -> dict[str, Any]:
    return {"robot": str(BAG.with_suffix(".yaml")), "source": source}


WAYS: dict[str, Callable[[Path, float], Through]] = {
    "dds": lambda folder, seconds: over_dds(folder, seconds, "reliable"),
    "dds-best-effort": lambda folder, seconds: over_dds(folder, seconds, "best-effort"),
    "ros1": through_ros1,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seconds", type=float, default=80.0, help="of the drive (75 s)")
    parser.add_argument("--only", default=",".join(WAYS))
    options = parser.parse_args()
    print("| through | scans played | mapped | lost | ATE, `online.tum` | agent a scan, its reader | dropped |")
    print("|---|---|---|---|---|---|---|")
    for name in options.only.split(","):
        with tempfile.TemporaryDirectory() as folder:
            print(WAYS[name](Path(folder), options.seconds).row(), flush=True)


if __name__ == "__main__":
    main()
