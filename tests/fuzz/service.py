"""The real service as a process, and robots that send it anything; a well-behaved one must not notice."""

from __future__ import annotations

import time
from collections import Counter
from pathlib import Path
from typing import Any

import grpc
import numpy as np

from splitslam import codec
from splitslam.codec import CODEC_VERSION
from splitslam.features import FeatureFrame
from splitslam.robot import Robot, robot_to_yaml
from splitslam.stack.process import descendants
from splitslam.stack.replica import Replica
from splitslam.wire import session_pb2 as pb
from tests.codec.frames import COLUMNS, ELEVATIONS_RAD, made_frame
from tests.codec.mutations import KINDS, sealed
from tests.codec.mutations import mutated as payload_mutated
from tests.fuzz.mutate import Rng, mutated
from tests.map_service.harness import STAMP_0_NS, hello, new_run

ANSWER_S = 20.0
_METHOD = "/splitslam.v1.EdgeService/Stream"


def rss_bytes(pid: int) -> int:
    """Resident memory of a process and of all it has started."""
    pages = 0
    for one in (pid, *descendants(pid)):
        try:
            pages += int(Path(f"/proc/{one}/statm").read_text().split()[1])
        except FileNotFoundError:
            continue
    return pages * 4096


class FuzzedService:
    """`seen`: how streams went. Raises AssertionError, or what gRPC raised, when the well-behaved robot suffers."""

    def __init__(self, folder: Path) -> None:
        settings = {"limits": {"client": {"opens_per_s": 1e4, "opens_burst": 10000}}}
        self.replica = Replica("fuzzed", folder, f"sqlite:///{folder / 'map.db'}", settings)
        self.replica.start()
        self.seen: Counter[str] = Counter()
        self._channel = grpc.insecure_channel(self.replica.address)
        self._stream = self._channel.stream_stream(_METHOD)  # bytes in, bytes out
        self._payloads = [_payload(made_frame(seed)) for seed in range(4)]

    def close(self) -> None:
        self._channel.close()
        self.replica.drain()

    def greeting(self) -> pb.Hello:
        robot = robot_to_yaml(Robot())
        beams = [float(b) for b in ELEVATIONS_RAD]
        return hello(new_run(), robot_file_yaml=robot, beam_elevations_rad=beams, codec_version=CODEC_VERSION)

    def rude(self, rng: Rng) -> None:
        """One stream: a Hello, mostly a good one, then frames and messages that are damaged in some way."""
        first = pb.StreamRequest(hello=self.greeting()).SerializeToString()
        messages = [first if rng.random() < 0.8 else mutated([first], rng)]
        for seq in range(1, int(rng.integers(2, 12))):
            whole = pb.StreamRequest(frame=self._frame(seq, self._damaged(rng))).SerializeToString()
            messages.append(whole if rng.random() < 0.8 else mutated([whole], rng))
        bye = pb.StreamRequest(bye=pb.Bye(last_seq=len(messages) - 1)).SerializeToString()
        messages.append(bye if rng.random() < 0.5 else b"\xff")  # else it would stay connected
        call = self._stream(iter(messages), timeout=ANSWER_S)
        try:
            for body in call:
                self.seen[str(pb.StreamResponse.FromString(body).WhichOneof("message"))] += 1
        except grpc.RpcError as error:
            code = error.code() if isinstance(error, grpc.Call) else None
            self.seen[str(code)] += 1
            if code in (grpc.StatusCode.UNKNOWN, grpc.StatusCode.DEADLINE_EXCEEDED):
                raise AssertionError("a stream failed or hung") from error

    def polite(self) -> None:
        """A whole run, every frame answered."""
        frames = [pb.StreamRequest(frame=self._frame(seq, self._payloads[0])) for seq in range(1, 4)]
        messages = [pb.StreamRequest(hello=self.greeting()), *frames, pb.StreamRequest(bye=pb.Bye(last_seq=3))]
        answered = 0
        for body in self._stream((m.SerializeToString() for m in messages), timeout=ANSWER_S):
            response = pb.StreamResponse.FromString(body)
            answered += response.HasField("odometry")
            if response.HasField("finished"):
                assert answered == 3, answered
                return
        raise AssertionError("the stream ended before the run was finished")

    def _frame(self, seq: int, payload: bytes) -> pb.Frame:
        stamp_ns = STAMP_0_NS + seq * 100_000_000
        return pb.Frame(seq=seq, stamp_ns=stamp_ns, dense=True, codec_version=CODEC_VERSION, payload=payload)

    def _damaged(self, rng: Rng) -> bytes:
        a, b = rng.integers(len(self._payloads), size=2)
        if rng.random() < 0.2:
            return self._payloads[a]
        kind = KINDS[rng.integers(len(KINDS))]
        body = payload_mutated(self._payloads[a], self._payloads[b], kind, rng)
        return sealed(body) if rng.random() < 0.9 else body

    def counts(self) -> dict[str, float]:
        """What the service itself says of how it went."""
        metrics: dict[str, Any] = self.replica.metrics()
        names = ("splitslam_map_worker_restarts_total", 'splitslam_map_frames_total{result="failed"}')
        return {name: metrics.get(name, 0.0) for name in names}

    def play(self, seconds: float, seed: int) -> None:
        """Rude streams, and after each twenty a polite one."""
        rng = np.random.default_rng(seed)
        until_s = time.monotonic() + seconds
        while time.monotonic() < until_s:
            for _ in range(20):
                self.rude(rng)
            self.polite()


def _payload(frame: FeatureFrame) -> bytes:
    return codec.encode(frame, ELEVATIONS_RAD, COLUMNS)
