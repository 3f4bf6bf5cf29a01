"""Ten seconds of a made drive between processes: what `uplink.dense: idle` brings, and what it leaves as it was."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from map_service.catalog import Catalog, StoredKeyframe
from map_service.export import map_pieces
from map_service.store import Store
from splitslam import se3
from splitslam.ply import read_ply
from splitslam.sim import DEMO
from splitslam.sim.recorder import SimRecording, simulate
from splitslam.sim.world import make_world
from splitslam.tum import read_tum
from tests import tolerances
from tests.conftest import ROOT
from tests.e2e.commands import splitslam
from tests.e2e.test_restart import kill, start_service

SPEC = replace(DEMO, duration_s=10.0)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> SimRecording:
    return simulate(SPEC, tmp_path_factory.mktemp("drive"))


@dataclass
class Rack:
    """A service that can be killed, and agents that talk to it."""

    folder: Path
    made: SimRecording
    service: subprocess.Popen[str]
    address: str

    def agent(self, name: str, state: str, realtime: bool = False, **uplink: Any) -> subprocess.Popen[str]:
        values = {
            "robot": str(self.made.robot_path),
            "server": self.address,
            "source": {"recording": str(self.made.bag_path), "realtime": realtime},
            "output": {"dir": str(self.folder / name)},
            "metrics": {"port": None},
            "state_dir": str(self.folder / state),
            "uplink": uplink,
        }
        config = self.folder / f"{name}.yaml"
        config.write_text(json.dumps(values))
        command = [sys.executable, "-m", "tests.edge_agent.unhurried", "run", "--config", str(config)]
        return subprocess.Popen(command, cwd=ROOT, stderr=subprocess.PIPE, text=True)

    def drive(self, name: str, **uplink: Any) -> dict[str, Any]:
        """A whole run."""
        return self.report(self.agent(name, f"state-{name}", **uplink), name)

    def report(self, agent: subprocess.Popen[str], name: str) -> dict[str, Any]:
        _, stderr = agent.communicate(timeout=200)
        assert agent.returncode == 0, stderr
        return json.loads((self.folder / name / "edge.json").read_text())

    def restart(self) -> None:
        kill(self.service)
        self.service, _ = start_service(self.folder / "map.db", int(self.address.rpartition(":")[2]))

    def keyframes(self, session_id: str) -> list[StoredKeyframe]:
        store = Store(f"sqlite:///{self.folder / 'map.db'}")
        with closing(store):
            catalog = Catalog(store)
            row = catalog.session(session_id)
            if row is None:
                return []
            with closing(catalog.keyframes(row.id, dense=True)) as keyframes:
                return list(keyframes)


@pytest.fixture(scope="module")
def rack(made: SimRecording, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rack]:
    folder = tmp_path_factory.mktemp("rack")
    rack = Rack(folder, made, *start_service(folder / "map.db"))
    yield rack
    kill(rack.service)


@pytest.fixture(scope="module")
def idle(rack: Rack) -> dict[str, Any]:
    return rack.drive("idle", dense="idle")


def test_the_live_stream_is_the_same_to_the_byte_and_every_keyframe_has_its_whole_scan(
    rack: Rack, idle: dict[str, Any]
) -> None:
    never = rack.drive("never")
    assert idle["uplink"]["payload_sha256"] == never["uplink"]["payload_sha256"]
    for name in ("online.tum", "odom.tum"):
        assert (rack.folder / "idle" / name).read_bytes() == (rack.folder / "never" / name).read_bytes()
    assert idle["uplink"]["live_bytes"] == pytest.approx(never["uplink"]["bytes"], rel=tolerances.SAME_LIVE_BYTES)
    keyframes = rack.keyframes(idle["session_id"])
    dense = [keyframe for keyframe in keyframes if keyframe.dense is not None]
    assert len(keyframes) >= 8
    assert len(dense) == idle["dense"]["sent"] == len(keyframes) - sum(idle["dense"]["dropped"].values())
    assert set(idle["dense"]["dropped"]) <= {"motion"}
    assert len(dense) >= len(keyframes) - 2
    assert idle["dense"]["waiting"] == 0
    clouds = sum(len(keyframe.dense or b"") for keyframe in dense)
    assert clouds < idle["uplink"]["dense_bytes"] < 1.1 * clouds
    assert idle["uplink"]["bytes"] == idle["uplink"]["live_bytes"] + idle["uplink"]["dense_bytes"]
    assert not list((rack.folder / "state-idle" / "spool" / "dense").glob("*/*.*"))
    assert never["dense"] == {"sent": 0, "waiting": 0, "dropped": {}, "bytes": 0}
    assert all(keyframe.dense is None for keyframe in rack.keyframes(never["session_id"]))
    print(f"{len(keyframes)} keyframes, {len(dense)} dense, {clouds / len(dense):.0f} bytes each, {idle['uplink']}")


def test_an_export_has_all_the_points_and_they_lie_on_the_same_surfaces(
    rack: Rack, made: SimRecording, idle: dict[str, Any]
) -> None:
    session, points = idle["session_id"], {}
    for way in ("--dense", "--no-dense"):
        out = rack.folder / f"map{way}.ply"
        result = splitslam("export", session, "--server", rack.address, "--out", str(out), way)
        assert result.returncode == 0, result.stderr
        assert (f"of {len(rack.keyframes(session))} keyframes dense" in result.stdout) == (way == "--dense")
        points[way] = sum(len(part) for part in read_ply(out))
    print(points)
    assert points["--dense"] >= tolerances.DENSE_POINTS * points["--no-dense"]
    keyframes = [keyframe for keyframe in rack.keyframes(session) if keyframe.dense is not None]
    whole = off_m(keyframes, made)
    live = off_m([replace(keyframe, dense=None) for keyframe in keyframes], made)
    for percent in (50, 90):
        of_whole, of_live = np.percentile(whole, percent), np.percentile(live, percent)
        print(f"{percent} %: {of_whole * 1e3:.1f} mm, live {of_live * 1e3:.1f} mm")
        assert of_whole < tolerances.DENSE_TO_LIVE * of_live


def off_m(keyframes: list[StoredKeyframe], made: SimRecording) -> np.ndarray:
    """How far points of the map are off the surface that their ray meets in the made world, across it, m."""
    truth = read_tum(made.truth_path)
    poses = zip(truth.stamps_ns, truth.positions_m, truth.quats_xyzw, strict=True)
    T_world = {int(stamp_ns): se3.from_quat(position_m, quat) for stamp_ns, position_m, quat in poses}
    T_world_map = T_world[keyframes[0].stamp_ns] @ np.linalg.inv(keyframes[0].T_map_lidar)
    off = []
    for keyframe, piece in zip(keyframes, map_pieces(keyframes, 0.0), strict=True):
        points = piece.points_map[:, :3].astype(float) @ T_world_map[:3, :3].T + T_world_map[:3, 3]
        rays = points - T_world[keyframe.stamp_ns][:3, 3]
        ranges = np.linalg.norm(rays, axis=1)
        origins = np.broadcast_to(T_world[keyframe.stamp_ns][:3, 3], rays.shape)
        hits = make_world(SPEC.world).cast(origins, rays / ranges[:, None])
        there = np.isfinite(hits.range_m)
        off.append(np.abs(hits.range_m - ranges)[there] * hits.cos_incidence[there])
    return np.concatenate(off)


def wait_until(condition: Callable[[], bool], what: str) -> None:
    until_s = time.monotonic() + 100.0
    while not condition():
        assert time.monotonic() < until_s, what
        time.sleep(0.02)


def test_an_agent_and_a_service_that_are_killed_half_way_cost_no_whole_scan(rack: Rack, idle: dict[str, Any]) -> None:
    first = rack.agent("killed", "state-killed", realtime=True, dense="idle")  # else it may be at its end by then
    runs = rack.folder / "state-killed" / "spool" / "dense"
    try:
        wait_until(lambda: len(list(runs.glob("*"))) == 1, "no whole scan was kept")
        session_id = f"{idle['session_id'].partition('/')[0]}/{next(runs.glob('*')).name}"
        wait_until(lambda: sum(k.dense is not None for k in rack.keyframes(session_id)) >= 2, "none has come")
    finally:
        first.send_signal(signal.SIGKILL)
        first.communicate()
    second = rack.agent("killed", "state-killed", dense="idle")
    wait_until(lambda: sum(k.dense is not None for k in rack.keyframes(session_id)) >= 4, "it did not go on")
    rack.restart()
    report = rack.report(second, "killed")
    keyframes = rack.keyframes(session_id)
    assert report["continued"]["after_scan"] > 0
    assert report["dense"]["waiting"] == 0
    without = [keyframe.index for keyframe in keyframes if keyframe.dense is None]
    assert len(keyframes) >= 8
    assert len(without) <= 4  # motions that nobody knew: the start, what came after the kill; what memory had of it
    print(without, report["dense"])
