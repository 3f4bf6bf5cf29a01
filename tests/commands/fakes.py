"""Stand-ins for both programs: `fakes.py edge|map MODE run|serve --config FILE`. Each mode is one way to behave."""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import yaml

from splitslam.run.processes import Programs

SCANS = 12
START_NS = 1_700_000_000_000_000_000
STEP_NS = 80_000_000
KEYFRAMES = 3
POINTS = 40


def programs(edge: str = "good", service: str = "good") -> Programs:
    """Command lines of fakes that behave so."""
    return Programs((sys.executable, __file__, "edge", edge), (sys.executable, __file__, "map", service))


def tum_lines(offset_m: float) -> str:
    return "".join(
        f"{START_NS // 10**9}.{k * STEP_NS:09d} {0.2 * k:.9f} {offset_m:.9f} 0 0 0 0 1\n" for k in range(SCANS)
    )


def edge_json() -> dict:
    times = {"mean": 1.0, "std": 0.1, "p50": 1.0, "p99": 2.0, "max": 2.5}
    stages = dict.fromkeys(("deskew", "motion", "features", "encode", "total"), times)
    return {
        "session_id": "robot/run",
        "run_id": "run",
        "scans": {"read": SCANS + 1, "sent": SCANS, "mapped": SCANS, "dropped": 1},
        "lost_scans": 3,
        "dropped_by_reason": {"nan": 1},
        "check": [],
        "recording_s": 1.2,
        "wall_s": 0.4,
        "edge_ms": stages,
        "edge_wall_ms": stages,
        "cpu_ms_per_scan": {"edge": 3.0, "reader": 2.0},
        "uplink": {
            "bytes": 60_000,
            "live_bytes": 59_000,
            "live_kbps": 390.0,
            "dense_bytes": 1000,
            "payload_bytes": 50_000,
            "payload_sha256": "0" * 64,
            "kbps": 400.0,
            "bytes_per_scan": 5000.0,
            "raw_kbps": 40_000.0,
            "native_kbps": None,
            "ratio_to_raw": 100.0,
            "limit_kbps": None,
            "withheld_points": 0,
        },
        "downlink": {"bytes": 6000, "kbps": 40.0},
        "dense": {"sent": 1, "waiting": 0, "dropped": {"full": 2}, "bytes": 1000},
        "round_trip_ms": times,
        "jumps": {"odom_max_m": 0.0, "odom_max_deg": 0.0, "map_count": 0, "map_max_m": 0.0},
        "wheels": {"factors": 7, "slips": 1, "scale": 0.01},
        "outages": {
            "alone": False,
            "count": 1,
            "seconds": 2.5,
            "scans": {"placed": 24},
            "correction_max_m": 0.01,
            "odometry_ms": None,
        },
        "deskew": {"back_end": "cpu", "troubles": {"timeout": 1}},
        "stamps_ns_by_scan": [START_NS + k * STEP_NS for k in range(SCANS)],
        "bytes_by_scan": [4000 + 100 * k for k in range(SCANS)],
        "dense_by_scan": [k % 4 == 0 for k in range(SCANS)],
        "round_trip_ms_by_scan": [5.0 + k for k in range(SCANS - 1)] + [None],
    }


def statistics_json() -> dict:
    times = {"mean": 4.0, "std": 1.0, "p50": 3.0, "p99": 9.0, "max": 11.0}
    stages = dict.fromkeys(("registration", "graph", "total"), times)
    return {
        "gnss_rejected": {"spacing": 3},
        "gravity_factors": 0,
        "map_ms": stages,
        "map_wall_ms": stages,
        "cpu_ms": 10.0 * SCANS,
        "loop_keyframes": [[0, 2]],
    }


def _note_pid(name: str) -> None:
    if folder := os.environ.get("FAKE_PIDS"):
        made = Path(f"{folder}.{name}")
        made.write_text(str(os.getpid()))
        made.rename(Path(folder, f"{name}.pid"))  # whole, as this process may be killed at any moment


def _edge(mode: str, config: dict) -> int:
    if mode == "bad_input":
        print("some.bag: topic /points: expected one of /a, /b", file=sys.stderr)
        return 2
    if mode == "note_then_bad_input":
        print("lidar.topic: /points chosen", file=sys.stderr)
        print("127.0.0.1:1: expected a map service there", file=sys.stderr)
        return 2
    print("lidar.topic: /points chosen", file=sys.stderr, flush=True)
    print(json.dumps({"event": "start", "scans": SCANS}), flush=True)
    for k in range(SCANS):
        print(json.dumps({"event": "scan", "read": k + 1, "mapped": k}), flush=True)
        if mode == "crash" and k == 5:
            raise RuntimeError("wheels came off")
        if mode == "killed" and k == 5:
            os.kill(os.getpid(), signal.SIGKILL)
        while mode in ("hang", "deaf") and k == 5:
            time.sleep(0.05)
    if mode == "stopped":
        return 0
    folder = Path(config["output"]["dir"])
    folder.mkdir()
    for name, offset_m in (("online.tum", 0.01), ("odom.tum", 0.0), ("imu.tum", 0.0)):
        (folder / name).write_text(tum_lines(offset_m))
    (folder / "online_covariance.csv").write_text("stamp_ns,state\n")
    (folder / "edge.json").write_text(json.dumps(edge_json()))
    if seen := os.environ.get("FAKE_CONFIG"):
        ours = [name for name in os.environ if name.startswith("SPLITSLAM_")]
        Path(seen).write_text(json.dumps(config | {"environment": ours}))
    print(json.dumps({"event": "end"}), flush=True)
    return 0


def _serve(mode: str) -> int:
    import grpc
    import numpy as np

    from splitslam.wire import session_pb2 as pb
    from splitslam.wire import session_pb2_grpc as rpc
    from splitslam.wire import types_pb2 as types

    class Sessions(rpc.SessionServiceServicer):
        def Get(self, request, context):
            session = pb.SessionInfo(session_id=request.session_id, keyframes=KEYFRAMES, loops=1, gnss_factors=2)
            session.statistics_json = json.dumps(statistics_json())
            return pb.GetResponse(session=session)

        def Trajectory(self, request, context):
            for k in range(0 if mode == "empty" else SCANS):
                pose = types.Transform(tx_m=0.2 * k, qw=1.0)
                yield pb.TrajectoryResponse(
                    poses=[types.StampedPose(seq=k + 1, stamp_ns=START_NS + k * STEP_NS, pose=pose)]
                )

        def StreamMap(self, request, context):
            for k in range(KEYFRAMES):
                points = np.random.default_rng(k).normal(size=(POINTS, 4)).astype("<f4")
                if mode == "no_map" and k == 1:
                    context.abort(grpc.StatusCode.DATA_LOSS, "the cloud is gone")
                yield pb.StreamMapResponse(
                    keyframe=k,
                    pose_map_lidar=types.Transform(tx_m=k, qw=1.0),
                    points=points.tobytes(),
                    point_count=POINTS,
                )

    if mode == "bad_port":
        print("listen 127.0.0.1:0: cannot be bound", file=sys.stderr)
        return 2
    if mode == "deaf":
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
    server = grpc.server(ThreadPoolExecutor(2))
    rpc.add_SessionServiceServicer_to_server(Sessions(), server)
    port = server.add_insecure_port("127.0.0.1:0")
    server.start()
    print(json.dumps({"event": "listening", "grpc": f"127.0.0.1:{port}", "metrics": None}), flush=True)
    if mode == "crash":
        time.sleep(0.3)
        print("Fatal: out of memory", file=sys.stderr)
        return 3
    while True:
        time.sleep(0.05)


if __name__ == "__main__":
    role, behaviour = sys.argv[1:3]
    _note_pid(role)
    if behaviour == "deaf":
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
    settings = yaml.safe_load(Path(sys.argv[sys.argv.index("--config") + 1]).read_text())
    sys.exit(_edge(behaviour, settings) if role == "edge" else _serve(behaviour))
