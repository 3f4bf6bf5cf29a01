"""`python -m tests.ros.listen ros2|ros1 SETTINGS`: what is said on /tf, odometry and diagnostics, JSON lines.

SETTINGS: JSON of the graph's settings. Says READY on stderr; runs until it is ended.
"""

from __future__ import annotations

import json
import signal
import sys
import threading
from typing import Any

from edge_agent.ros.codec import DIAGNOSTICS, TF
from edge_agent.ros.connect import join
from edge_agent.ros.graph import RELIABLE, TRANSFORMS
from edge_agent.ros.messages import ODOMETRY
from edge_agent.ros.settings import Ros1Settings, Ros2Settings
from edge_agent.sources.messages import stamp_ns

READY = "listening"
TOPICS = {"/tf": (TF, TRANSFORMS), "/splitslam/odometry": (ODOMETRY, RELIABLE), "/diagnostics": (DIAGNOSTICS, RELIABLE)}


def main(kind: str, settings: str) -> None:
    stop = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: stop.set())
    values = json.loads(settings)
    graph = join(Ros1Settings(**values) if kind == "ros1" else Ros2Settings(**values), stop)
    lock = threading.Lock()

    def heard(topic: str, msgtype: str, raw: bytes) -> None:
        line = json.dumps({"topic": topic, **plain(graph.codec.decode(raw, msgtype))})
        with lock:
            print(line, flush=True)

    for topic, (msgtype, delivery) in TOPICS.items():
        graph.subscribe(topic, msgtype, delivery, lambda raw, at=topic, of=msgtype: heard(at, of, raw))
    print(READY, file=sys.stderr, flush=True)
    stop.wait()
    graph.close()


def plain(message: Any) -> dict[str, Any]:
    """What the tests look at."""
    if hasattr(message, "transforms"):
        return {"transforms": [_transform(stamped) for stamped in message.transforms]}
    if hasattr(message, "status"):
        status = message.status[0]
        pairs = {pair.key: pair.value for pair in status.values}
        return {"level": int(status.level), "name": status.name, "message": status.message, "values": pairs}
    pose, twist = message.pose.pose, message.twist.twist
    return {
        "parent": message.header.frame_id,
        "child": message.child_frame_id,
        "stamp_ns": stamp_ns(message.header),
        "pose": [*_xyz(pose.position), *_xyz(pose.orientation), pose.orientation.w],
        "pose_covariance": message.pose.covariance.tolist(),
        "twist": [*_xyz(twist.linear), *_xyz(twist.angular)],
        "twist_covariance": message.twist.covariance.tolist(),
    }


def _transform(stamped: Any) -> dict[str, Any]:
    t, q = stamped.transform.translation, stamped.transform.rotation
    return {
        "parent": stamped.header.frame_id,
        "child": stamped.child_frame_id,
        "stamp_ns": stamp_ns(stamped.header),
        "pose": [*_xyz(t), *_xyz(q), q.w],
    }


def _xyz(vector: Any) -> tuple[float, float, float]:
    return vector.x, vector.y, vector.z


if __name__ == "__main__":
    main(*sys.argv[1:])
