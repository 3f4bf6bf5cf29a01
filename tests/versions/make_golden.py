"""Makes tests/versions/golden/VERSION: what a release writes, for those after it to read.

    python -m tests.versions.make_golden            this release's, once, when it is made
    python -m tests.versions.make_golden previous   those of the wheel in this folder

hello.bin, dense.bin, sparse.bin: a made drive's Hello and two of its Frames, as they go on the wire; dense.npz,
sparse.npz: what they decode to. wire.json: every message with every field (tests/wire/samples.py). store.sql.xz: a
SQLite store with a finished and an unfinished run; store.json: their poses. spool/: a run folder of the agent.
"""

from __future__ import annotations

import json
import lzma
import os
import sqlite3
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import grpc
import numpy as np

from edge_agent.spool import SpoolFolder
from splitslam import __version__, codec
from splitslam.features import FeatureFrame
from splitslam.sim import simulate
from splitslam.wire import session_pb2 as pb
from splitslam.wire import session_pb2_grpc as rpc
from tests.conftest import ROOT
from tests.edge_agent.fake_service import FakeService
from tests.sim.drives import SHORT
from tests.versions import previous
from tests.versions.mixed import NEW_AGENT, NEW_SERVICE, RUN_S, Service, Switch, robot, sessions_of, wait_until

GOLDEN = Path(__file__).with_name("golden")
SPOOL_BYTES = 1 << 20


class Recorder(FakeService):
    """Keeps the frames as they come."""

    frames: list[pb.Frame] = []  # noqa: RUF012 (of the one there is)

    def Stream(self, request_iterator: Iterator[pb.StreamRequest], context: grpc.ServicerContext):
        yield from super().Stream(self._kept(request_iterator), context)

    def _kept(self, requests: Iterator[pb.StreamRequest]) -> Iterator[pb.StreamRequest]:
        for request in requests:
            if request.HasField("frame"):
                self.frames.append(request.frame)
            yield request


def decoded(frame: pb.Frame, hello: pb.Hello) -> FeatureFrame:
    beams = np.array(hello.beam_elevations_rad, np.float32)
    return codec.decode(frame.payload, frame.seq, frame.stamp_ns, frame.dense, beams)


def arrays(frame: FeatureFrame) -> dict[str, np.ndarray]:
    """What a frame says, by name."""
    found = {}
    for kind in ("corners", "surfs"):
        features = getattr(frame, kind)
        for name in ("points_lidar", "ring", "column", "t_offset_ns", "intensity"):
            found[f"{kind}_{name}"] = getattr(features, name)
    motion = frame.motion
    knots = (motion.knots.offsets_ns, motion.knots.rotation, motion.knots.translation_m)
    found |= dict(zip(("knots_ns", "knots_rotation", "knots_m"), knots, strict=True))
    return found | {"T_prev_lidar": motion.T_prev_lidar, "covariance": motion.covariance}


def poses_of(target: tuple[str, int]) -> dict[str, list[list[float]]]:
    """[seq, stamp_ns, x, y, z, qx, qy, qz, qw] of every stored pose, by robot."""
    found = {}
    with grpc.insecure_channel(f"{target[0]}:{target[1]}") as channel:
        for name, session in sessions_of(target).items():
            request = pb.TrajectoryRequest(session_id=session.session_id)
            chunks = rpc.SessionServiceStub(channel).Trajectory(request, timeout=60)
            found[name] = [
                [p.seq, p.stamp_ns, p.pose.tx_m, p.pose.ty_m, p.pose.tz_m, p.pose.qx, p.pose.qy, p.pose.qz, p.pose.qw]
                for chunk in chunks
                for p in chunk.poses
            ]
    return found


def make(version: str, service: Sequence[str], agent: Sequence[str], environment: dict[str, str]) -> None:
    out = GOLDEN / version
    out.mkdir(parents=True)
    samples = (sys.executable, str(ROOT / "tests" / "wire" / "samples.py"))
    wire = subprocess.run(samples, env=environment, cwd="/", capture_output=True, check=True, text=True).stdout
    (out / "wire.json").write_text(json.dumps(json.loads(wire)["messages"], indent=1) + "\n")
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        recording = simulate(SHORT, folder / "drive").bag_path
        hello, frames = _frames(agent, recording, folder, out)
        _store(service, agent, recording, folder, out)
    if version == __version__:
        _spool(hello, frames, out)


def _frames(agent: Sequence[str], recording: Path, folder: Path, out: Path) -> tuple[pb.Hello, list[pb.Frame]]:
    service = Recorder()
    with service:
        robot("golden", agent, recording, service.address, folder).wait_end()
    (hello,), frames = service.hellos, service.frames
    (out / "hello.bin").write_bytes(hello.SerializeToString())
    sparse = next(frame for frame in frames if not frame.dense and frame.seq > 8)
    for name, frame in (("dense", frames[0]), ("sparse", sparse)):
        (out / f"{name}.bin").write_bytes(frame.SerializeToString())
        np.savez_compressed(out / f"{name}.npz", **arrays(decoded(frame, hello)))  # pyright: ignore[reportArgumentType]
    return hello, frames


def _store(service: Sequence[str], agent: Sequence[str], recording: Path, folder: Path, out: Path) -> None:
    store = folder / "map.db"
    running = Service(service, store, folder / "service.log")
    running.wait_ready()
    robot("finished", agent, recording, f"127.0.0.1:{running.target[1]}", folder).wait_end()
    way = Switch(running.target)
    killed = robot("unfinished", agent, recording, way.address, folder)

    def far_enough() -> bool:
        found = sessions_of(running.target).get("unfinished")
        return found is not None and found.durable_seq >= 12

    wait_until(far_enough, "the second run", RUN_S)
    killed.process.kill()
    killed.process.wait()
    way.close()
    wait_until(lambda: sessions_of(running.target)["unfinished"].durable_seq >= 12, "its commit", RUN_S)
    (out / "store.json").write_text(json.dumps(poses_of(running.target)) + "\n")
    running.close()
    with sqlite3.connect(store) as database:
        (out / "store.sql.xz").write_bytes(lzma.compress("\n".join(database.iterdump()).encode()))


def _spool(hello: pb.Hello, frames: list[pb.Frame], out: Path) -> None:
    """Ten frames, of which the first two are durable and the fifth was given up."""
    spools = SpoolFolder(out / "spool", SPOOL_BYTES)
    run = spools.run(hello.run_id)
    run.begin(hello)
    spool = spools.open(run)
    for frame in frames[:10]:
        spool.put(frame, 0 if frame.seq < 6 else 2)
    spool.give_up(5)
    run.note_dropped({"buffer_full": 1})
    spool.close()
    spools.close()
    (out / "spool" / "lock").unlink()


if __name__ == "__main__":
    if sys.argv[1:] == ["previous"]:
        programs = (previous.command("map_service"), previous.command("edge_agent"))
        make(previous.VERSION, *programs, previous.environment())
    else:
        make(__version__, NEW_SERVICE, NEW_AGENT, {**os.environ, "PYTHONPATH": str(ROOT)})
