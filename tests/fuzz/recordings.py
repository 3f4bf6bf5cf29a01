"""Whole recordings with damaged bytes: ROS 1 bags, ROS 2 ones in MCAP and in SQLite."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from edge_agent.sources.recording import open_recording
from splitslam.errors import InputError
from tests.fuzz.mutate import Rng, mutated
from tests.fuzz.target import Target, scratch
from tests.sources import made_bags, robots
from tests.sources.made_bags import MCAP, ROS1, SQLITE3, T0_NS, cloud, write_bag

_SUFFIX = {ROS1: ".bag", MCAP: ".mcap", SQLITE3: ".db3"}
_SCANS = 8


def recordings() -> Target:
    folder, remove = scratch()
    whole = {kind: _whole(folder, kind) for kind in (ROS1, MCAP, SQLITE3)}
    kinds, robot = list(whole), robots.robot("rings: 16")

    def make(rng: Rng) -> tuple[str, bytes]:
        kind = kinds[rng.integers(len(kinds))]
        data = whole[kind]
        start = 16 if rng.random() < 0.9 else 0  # else even the magic may go
        return kind, data[:start] + mutated([data[start:]], rng)

    def feed(given: tuple[str, bytes]) -> None:
        """Opened and read to its end, as `splitslam run` does."""
        kind, data = given
        path = folder / f"damaged{_SUFFIX[kind]}"
        path.write_bytes(data)
        with open_recording(path, robot) as recording:
            for arrival_ns, _ in recording.events():
                assert isinstance(arrival_ns, int)

    return Target("recordings", make, feed, (InputError,), remove)


def _whole(folder: Path, kind: str) -> bytes:
    dtype = np.dtype([("x", "f4"), ("y", "f4"), ("z", "f4"), ("intensity", "f4"), ("ring", "u2"), ("time", "f4")])
    rng = np.random.default_rng(0)
    messages: list[Any] = []
    for n in range(_SCANS):
        points = np.zeros(64, dtype)
        points["x"], points["y"], points["z"] = rng.normal(0, 10, (3, 64))
        points["ring"], points["time"] = np.arange(64) % 16, np.linspace(0, 0.1, 64)
        stamp_ns = T0_NS + n * 100_000_000
        messages.append(cloud(points, stamp_ns, arrival_ns=stamp_ns))
        messages += [made_bags.imu(stamp_ns + k * 10_000_000) for k in range(10)]
    (home := folder / kind).mkdir()
    path = write_bag(home, kind, messages)
    return (path if path.is_file() else next(path.glob(f"*{_SUFFIX[kind]}"))).read_bytes()
