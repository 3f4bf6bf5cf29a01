"""How long after a start the map service answers the first frame of a long session.

    python -m benchmarks.restart --keyframes 3000 [--store URL]

A session is driven through the pipeline at a metre a keyframe, committed as a worker would, and left unfinished. Then
`map-service serve` is started as a process, and a robot resumes: from the start of the interpreter to its first answer.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import threading
import time
import uuid
from pathlib import Path

import grpc
import numpy as np

from benchmarks.blocks import FRAME_NS, block_frame
from map_service.engine import SlamEngine
from map_service.hello import SessionRequest, read_hello
from map_service.rows import SessionCommit
from map_service.settings import PipelineSettings
from map_service.store import Store
from splitslam import codec
from splitslam.robot import Robot, robot_to_yaml
from splitslam.wire import session_pb2 as pb
from splitslam.wire import session_pb2_grpc as rpc
from splitslam.wire import types_pb2 as types_pb

ROOT = Path(__file__).resolve().parent.parent
_BEAMS_RAD = np.deg2rad(np.linspace(-15.0, 15.0, 16)).astype(np.float32)
_COLUMNS = 1800


def hello(run_id: str) -> pb.Hello:
    robot = Robot(imu=None, gnss=None)
    return pb.Hello(
        robot_id="restart",
        run_id=run_id,
        robot_file_yaml=robot_to_yaml(robot),
        beam_elevations_rad=_BEAMS_RAD.tolist(),
        wire_version=1,
        codec_version=codec.CODEC_VERSION,
        deskew="cpu",
        lockstep=True,
    )


def drive(url: str, run_id: str, keyframes: int) -> int:
    """Writes the session; returns the seq of its last frame."""
    store, engine = Store(url), SlamEngine(PipelineSettings(), 1)
    engine.warm_up()
    request: SessionRequest = read_hello(hello(run_id), codec.CODEC_VERSION)
    pipeline = engine.create(request, None)
    opened = store.open_session(request.opening)
    T_map_odom: dict[int, np.ndarray] = {}
    previous = seq = 0
    found = 0
    while found < keyframes:
        seq += 1
        answer = pipeline.answer(block_frame(seq, _BEAMS_RAD), [])
        pipeline.settle()
        T_map_odom[seq] = answer.T_map_odom
        found += answer.keyframe
        if (answer.keyframe and found % 20 == 0) or found == keyframes:
            commit = pipeline.take_commit()
            store.commit(opened.key, opened.epoch, SessionCommit(commit, T_map_odom))
            previous, T_map_odom = commit.last_seq, {}
    assert previous == seq
    engine.close()
    store.close()
    return seq


def restart(url: str, run_id: str, seq: int) -> dict:
    """Starts the service, resumes with the frame after `seq`; s from the start, and CPU s of all its processes."""
    body = codec.encode(block_frame(seq + 1, _BEAMS_RAD), _BEAMS_RAD, _COLUMNS)
    command = [sys.executable, "-m", "map_service", "serve", "--listen", "127.0.0.1:0", "--store", url]
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    start_s = time.monotonic()
    with subprocess.Popen(
        [*command, "--workers", "1", "--metrics-port", "0"], stdout=subprocess.PIPE, text=True, cwd=ROOT
    ) as service:
        try:
            assert service.stdout is not None
            address = json.loads(service.stdout.readline())["grpc"]
            listening_s = time.monotonic() - start_s
            with grpc.insecure_channel(address) as channel:
                stop = threading.Event()

                def requests():
                    yield pb.StreamRequest(hello=hello(run_id))
                    frame = pb.Frame(
                        seq=seq + 1, stamp_ns=(seq + 1) * FRAME_NS, dense=True, payload=body,
                        codec_version=codec.CODEC_VERSION,
                    )  # fmt: skip
                    yield pb.StreamRequest(frame=frame)
                    stop.wait()

                for response in rpc.EdgeServiceStub(channel).Stream(requests()):
                    match response.WhichOneof("message"):
                        case "welcome":
                            welcome_s = time.monotonic() - start_s
                            seq_durable = response.welcome.durable_seq
                            assert seq_durable == seq, f"{seq_durable} is durable, expected {seq}"
                        case "odometry":
                            answer_s = time.monotonic() - start_s
                            state = response.odometry.state
                            break
                        case "refused":
                            raise RuntimeError(response.refused.detail)
                stop.set()
        finally:
            service.terminate()
            service.wait(30)
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return {
        "listening_s": round(listening_s, 3),
        "welcome_s": round(welcome_s, 3),
        "answer_s": round(answer_s, 3),
        "cpu_s": round(used.ru_utime + used.ru_stime - spent.ru_utime - spent.ru_stime, 3),
        "state": types_pb.TrackingState.Name(state).removeprefix("TRACKING_STATE_"),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--keyframes", type=int, default=3000)
    parser.add_argument("--store", help="URL; default: a SQLite file that is thrown away")
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--keep", type=Path, help="JSON of a session driven before; made when missing")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        url = options.store or f"sqlite:///{folder}/map.db"
        if options.keep and options.keep.exists():
            run_id, seq = json.loads(options.keep.read_text())
        else:
            run_id = str(uuid.uuid4())
            start_s = time.monotonic()
            seq = drive(url, run_id, options.keyframes)
            print(f"driven in {time.monotonic() - start_s:.0f} s", file=sys.stderr)
            if options.keep:
                options.keep.write_text(json.dumps([run_id, seq]))
        for again in range(options.repeat):  # each adds a frame
            print(json.dumps({"frames": seq + again, **restart(url, run_id, seq + again)}), flush=True)
        if options.keep:
            options.keep.write_text(json.dumps([run_id, seq + options.repeat]))


if __name__ == "__main__":
    main()
