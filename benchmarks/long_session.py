"""Hours of one session through the real session, pipeline and store in this process, as fast as they go.

    python -m benchmarks.long_session new --minutes 120
    python -m benchmarks.long_session loop --minutes 480

`new`: two hours over new ground: does a scan cost in the second hour what it cost in the first minute, and how fast
does memory grow? `loop`: eight hours on the same 100 m, two of them parked: keyframes, store and memory must stay what
they were after the second lap. Frames are made as features of a town (town.py), so they pass no codec and no network.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
import uuid
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from sqlalchemy import LargeBinary, Text, func, select

from benchmarks.town import FRAME_NS, Robot, round_and_round, straight_on
from map_service import schema
from map_service.accounts import SessionAccounts
from map_service.block_keeping import BlockKeeper
from map_service.block_warm_up import warm_up_blocks
from map_service.commits import Committer
from map_service.config import CommitConfig, PosesConfig
from map_service.engine import SlamEngine
from map_service.hello import WIRE_VERSION, SessionRequest, read_hello
from map_service.pipeline import MapPipeline
from map_service.processes import resident_bytes
from map_service.session import Session
from map_service.settings import PipelineSettings
from map_service.store import Store
from map_service.tally import Tally
from splitslam import codec
from splitslam.features import FeatureFrame
from splitslam.robot import Robot as RobotFile
from splitslam.robot import robot_to_yaml
from splitslam.wire import session_pb2 as pb

SPEED_MPS, LAP_M = 1.0, 100.0
AHEAD = 100  # frames of the store
_POSES = (schema.frames, schema.pose_blocks, schema.anchors)


@dataclass(frozen=True, slots=True)
class Sample:
    """How the session stands after so many scans.

    map_ms: mean CPU time a scan since the last sample, commits composed and written included; largest_ms: of one scan.
    loop_ms: the same mean, of loops verified, which a service leaves to its pool.
    """

    scans: int
    seconds: float
    map_ms: float
    largest_ms: float
    loop_ms: float
    keyframes: int
    loops: int
    clouds_loaded: int
    rss_mb: float
    store_mb: float  # pages of the database that hold something
    poses_mb: float  # of scans: contents of rows, blocks and anchors
    rest_mb: float  # contents of all else
    thinned: int  # scans without a pose of their own
    off_m: float  # from the truth


class _Engine(SlamEngine):
    """Takes the frame that is given to it for the one that comes in."""

    def __init__(self) -> None:
        super().__init__(PipelineSettings(), 1)
        self.frame: FeatureFrame | None = None
        self.warm_up()

    def decode(self, frame: pb.Frame, request: SessionRequest) -> FeatureFrame:
        if self.frame is None:  # warming up
            return super().decode(frame, request)
        assert self.frame.seq == frame.seq
        return self.frame


class LongSession:
    """One session of `robot` with its store at `url`; `play` goes on from where it stands."""

    def __init__(self, robot: Robot, url: str, way, poses: PosesConfig | None = None) -> None:
        self._robot, self._way = robot, way
        self.store, self._engine, tally = Store(url), _Engine(), Tally()
        hello = pb.Hello(
            robot_id="long",
            run_id=str(uuid.uuid4()),
            robot_file_yaml=robot_to_yaml(RobotFile(imu=None, gnss=None)),
            beam_elevations_rad=np.deg2rad(np.linspace(-15.0, 15.0, 16)).tolist(),
            wire_version=WIRE_VERSION,
            codec_version=codec.CODEC_VERSION,
            deskew="off",
            lockstep=True,
        )
        self._request, self._tally, self.seq = read_hello(hello, codec.CODEC_VERSION), tally, 0
        self._committer = Committer(self.store, CommitConfig(), tally)
        self._keeper = BlockKeeper(self.store, poses or PosesConfig())
        warm_up_blocks()
        self.reopen()

    def reopen(self) -> None:
        """The session as the store has it."""
        opened = self.store.open_session(self._request.opening)
        self._log = self._committer.log(opened.key, opened.epoch, opened.last_seq)
        accounts = SessionAccounts("", time.process_time_ns)
        self.session = Session(self._request, self._log, self._engine, self.store, self._tally, accounts)
        self.began_at = self.pipeline.ground.reference

    @property
    def pipeline(self) -> MapPipeline:
        assert isinstance(self.session._pipeline, MapPipeline)
        return self.session._pipeline

    def play(self, scans: int) -> Sample:
        """So many more."""
        spent_ns, largest_ns, loops_ns, position_m = 0, 0, self._engine.pool_cpu_ns(), np.zeros(3)
        for _ in range(scans):
            self.seq += 1
            self._engine.frame = self._robot.frame(self.seq)
            frame = pb.Frame(seq=self.seq, stamp_ns=self.seq * FRAME_NS, codec_version=codec.CODEC_VERSION)
            begin_ns = time.process_time_ns()
            answer = self.session.apply(frame)
            self.session.settle()
            self._log.collect()
            if self.session.commit_due:
                self.session.commit()
            if self._log.undurable > AHEAD:  # the store gets its turn, as it would by the clock
                self._log.flush(60.0)
            took_ns = time.process_time_ns() - begin_ns
            spent_ns, largest_ns = spent_ns + took_ns, max(largest_ns, took_ns)
            self._tally.take()
            p = answer.pose_map_lidar
            position_m = np.array([p.tx_m, p.ty_m, p.tz_m])
        loop_ns = self._engine.pool_cpu_ns() - loops_ns
        return self._sample(spent_ns * 1e-6 / scans, largest_ns * 1e-6, loop_ns * 1e-6 / scans, position_m)

    def _sample(self, map_ms: float, largest_ms: float, loop_ms: float, position_m: np.ndarray) -> Sample:
        self.session.commit()
        self._log.flush(60.0)
        at_start, now = self._way(FRAME_NS * 1e-9), self._way(self.seq * FRAME_NS * 1e-9)
        expected_m = at_start[:3, :3].T @ (now[:3, 3] - at_start[:3, 3])
        self._keeper.run(time.time(), most=1 << 30)
        poses, rest = self._contents()
        pipeline = self.pipeline
        return Sample(
            scans=self.seq,
            seconds=self.seq * FRAME_NS * 1e-9,
            map_ms=round(map_ms, 3),
            largest_ms=round(largest_ms, 1),
            loop_ms=round(loop_ms, 3),
            keyframes=len(pipeline.keyframes),
            loops=len(pipeline.graph.loops),
            clouds_loaded=pipeline.keyframes.clouds.loaded,
            rss_mb=round(resident_bytes() / 1e6, 1),
            store_mb=round(self._used_bytes() / 1e6, 3),
            poses_mb=round(poses / 1e6, 3),
            rest_mb=round(rest / 1e6, 3),
            thinned=self._thinned(),
            off_m=round(float(np.linalg.norm(position_m - expected_m)), 3),
        )

    def _contents(self) -> tuple[int, int]:
        """Bytes of texts and blobs: of poses by scan, and of the rest."""
        size = {}
        with self.store.reading() as connection:
            for table in (schema.sessions, *schema.SESSION_TABLES):
                columns = [c for c in table.columns if isinstance(c.type, LargeBinary | Text)]
                query = select(*(func.coalesce(func.sum(func.length(c)), 0) for c in columns))
                size[table] = sum(map(int, connection.execute(query).one())) if columns else 0
        poses = sum(size[table] for table in _POSES)
        return poses, sum(size.values()) - poses

    def _used_bytes(self) -> int:
        with self.store.reading() as connection:
            pages, free, size = (
                connection.exec_driver_sql(f"PRAGMA {name}").scalar_one()
                for name in ("page_count", "freelist_count", "page_size")
            )
        return (pages - free) * size

    def _thinned(self) -> int:
        with self.store.reading() as connection:
            return int(connection.execute(select(func.sum(schema.pose_blocks.c.thinned))).scalar() or 0)

    def close(self) -> None:
        self._engine.close()
        self.store.close()


def new_ground(minutes: float, url: str, poses: PosesConfig) -> Iterator[Sample]:
    """A sample a minute."""
    town, way = straight_on(SPEED_MPS)
    yield from _play(LongSession(Robot(town, way), url, way, poses), [600] * round(minutes))


def same_loop(minutes: float, url: str, poses: PosesConfig) -> Iterator[Sample]:
    """A sample a lap; a quarter of the time parked, after the first half."""
    lap = round(LAP_M / SPEED_MPS * 1e9 / FRAME_NS)
    parked_s = (minutes * 30.0, minutes * 45.0)
    town, way = round_and_round(LAP_M, SPEED_MPS, parked_s)
    yield from _play(LongSession(Robot(town, way), url, way, poses), [lap] * max(2, round(minutes * 600 / lap)))


def _play(session: LongSession, parts: list[int]) -> Iterator[Sample]:
    try:
        for scans in parts:
            yield session.play(scans)
    finally:
        session.close()


def verdict(kind: str, samples: list[Sample]) -> dict[str, float]:
    """What the bars are about."""
    last = samples[-1]
    if kind == "loop":
        lap2 = samples[1]
        return {
            "keyframes": last.keyframes / lap2.keyframes,
            "store": last.store_mb / lap2.store_mb,
            "store_without_poses": last.rest_mb / lap2.rest_mb,
            "poses_bytes_an_hour": (last.poses_mb - lap2.poses_mb) * 1e6 / ((last.seconds - lap2.seconds) / 3600.0),
            "rss": last.rss_mb / lap2.rss_mb,
        }
    half = len(samples) // 2
    second = samples[half:]
    hours = (last.seconds - samples[half - 1].seconds) / 3600.0
    return {
        "second_half_to_first_minute": float(np.mean([s.map_ms for s in second])) / samples[0].map_ms,
        "rss_mb_an_hour": (last.rss_mb - samples[half - 1].rss_mb) / hours,
        "rss_mb_an_hour_whole": (last.rss_mb - samples[0].rss_mb) / ((last.seconds - samples[0].seconds) / 3600.0),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kind", choices=("new", "loop"))
    parser.add_argument("--minutes", type=float, help="of the session; default 120 and 480")
    parser.add_argument("--out", type=Path, help="JSON of all samples")
    parser.add_argument("--full-rate-h", type=float, default=PosesConfig().full_rate_h, help="poses.full_rate_h")
    parser.add_argument("--within-m", type=float, default=PosesConfig().within_m, help="poses.within_m")
    options = parser.parse_args()
    poses = PosesConfig(full_rate_h=options.full_rate_h, within_m=options.within_m)
    minutes = options.minutes or {"new": 120.0, "loop": 480.0}[options.kind]
    samples, began_s = [], time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        for sample in (new_ground if options.kind == "new" else same_loop)(
            minutes, f"sqlite:///{folder}/map.db", poses
        ):
            samples.append(sample)
            print(json.dumps(asdict(sample)), file=sys.stderr, flush=True)
    result = {
        "kind": options.kind,
        "minutes": minutes,
        "wall_s": round(time.monotonic() - began_s, 1),
        "load": os.getloadavg()[0],
        "verdict": {name: round(value, 3) for name, value in verdict(options.kind, samples).items()},
        "samples": [asdict(sample) for sample in samples],
    }
    if options.out:
        options.out.write_text(json.dumps(result, indent=1) + "\n")
    print(json.dumps({name: value for name, value in result.items() if name != "samples"}))


if __name__ == "__main__":
    main()
