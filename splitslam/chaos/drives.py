"""Four robots in one made yard: the demo's lap, begun at four places of it."""

from __future__ import annotations

import concurrent.futures
import multiprocessing
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from splitslam.chaos.agent import Drive
from splitslam.sim.spec import DEMO, DriveSpec


def specs(seconds: float, seed: int, robots: int = 4) -> list[DriveSpec]:
    """The same lap and people; another start, other noise, and every second robot the other way round."""
    lap = DEMO.path.waypoints_m
    made = []
    for k in range(robots):
        first = k * len(lap) // robots
        way = lap[first:] + lap[:first]
        path = replace(DEMO.path, waypoints_m=way if k % 2 == 0 else way[:1] + way[:0:-1])
        made.append(replace(DEMO, name=f"robot-{k + 1}", seed=seed + k, duration_s=seconds, path=path))
    return made


def make(wanted: list[DriveSpec], folder: Path, progress: Callable[[int, int], None]) -> list[Drive]:
    """Makes them all, as many at once as there are cores; progress(done, total) counts scans."""
    total = round(sum(spec.duration_s * spec.lidar.rate_hz for spec in wanted))
    context = multiprocessing.get_context("spawn")
    with context.Manager() as manager:
        scans = manager.Queue()
        with concurrent.futures.ProcessPoolExecutor(min(len(wanted), os.cpu_count() or 1), context) as pool:
            made = [pool.submit(_make_one, spec, folder / spec.name, scans) for spec in wanted]
            done = 0
            while not all(each.done() for each in made):
                concurrent.futures.wait(made, timeout=0.2)
                while not scans.empty():
                    done += scans.get()
                progress(min(done, total), total)
            return [each.result() for each in made]


def _make_one(spec: DriveSpec, folder: Path, scans) -> Drive:
    from splitslam.sim.recorder import simulate

    made = simulate(spec, folder, lambda done, total: scans.put(10) if done % 10 == 0 else None)
    return Drive(made.bag_path, made.robot_path, made.truth_path)
