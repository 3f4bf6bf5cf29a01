"""`python -m tests.ros.through_rclpy DOMAIN`: what two nodes say to each other by rclpy.

Prints JSON, a line for each thing that was tried.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable

import numpy as np

from edge_agent.ros.codec import Codec
from edge_agent.ros.graph import RELIABLE, SAMPLES, SCANS, STATIC, Graph
from edge_agent.ros.rclpy_graph import RclpyGraph
from edge_agent.ros.settings import Ros2Settings
from tests.sources import made_bags as made

CODEC = Codec("cdr")
POINTS, SAMPLES_SENT = 26_000, 200


def main(domain: int) -> None:
    robot = RclpyGraph(Ros2Settings(domain_id=domain, node="robot"))
    agent = RclpyGraph(Ros2Settings(domain_id=domain, namespace="fleet/rover_7"))
    print(json.dumps({"names": [robot.name, agent.name]}))
    imu = [_message(made.imu(made.T0_NS + k, gyro=(0.1, 0.2, float(k)))) for k in range(SAMPLES_SENT)]
    cloud = _message(made.cloud(made.structured(np.ones((POINTS, 3), np.float32), made.VELODYNE, 22), made.T0_NS))
    hear(robot, agent, "/imu/data", made.IMU, imu)
    hear(robot, agent, "/points_raw", made.CLOUD, [cloud] * 5)
    latched(robot, agent, imu[0])
    failing(robot, agent, imu[:2])
    for graph in (agent, robot, robot):
        graph.close()


def hear(speaker: Graph, listener: Graph, topic: str, msgtype: str, messages: list[bytes]) -> None:
    """All that one says, after the other has found it."""
    send = speaker.advertise(topic, msgtype, RELIABLE)
    found = _until(lambda: listener.topics().get(topic) == msgtype)
    own = topic in speaker.topics()
    heard: list[bytes] = []
    listener.subscribe(topic, msgtype, SCANS if msgtype == made.CLOUD else SAMPLES, heard.append)
    connected = _until(lambda: send(messages[0]) or heard)
    before = -1
    while before != len(heard):  # until all has come that was said meanwhile
        before = len(heard)
        time.sleep(1.0)
    heard.clear()
    for message in messages:
        send(message)
    _until(lambda: len(heard) >= len(messages))
    said = {"found": found, "own": own, "connected": connected, "whole": heard == messages, "heard": len(heard)}
    print(json.dumps({"topic": topic, **said, "lost": dict(listener.lost)}), flush=True)


def latched(speaker: Graph, listener: Graph, message: bytes) -> None:
    """What was said before the other came."""
    speaker.advertise("/static", made.IMU, STATIC)(message)
    heard: list[bytes] = []
    listener.subscribe("/static", made.IMU, STATIC, heard.append)
    print(json.dumps({"topic": "/static", "whole": bool(_until(lambda: heard == [message]))}), flush=True)


def failing(speaker: Graph, listener: Graph, messages: list[bytes]) -> None:
    """What comes after a message that the listener fails at."""
    send = speaker.advertise("/failing", made.IMU, RELIABLE)
    heard: list[bytes] = []

    def receive(raw: bytes) -> None:
        if raw == messages[0]:
            raise ValueError("cannot be read")
        heard.append(raw)

    listener.subscribe("/failing", made.IMU, SAMPLES, receive)
    failed = _until(lambda: send(messages[0]) or listener.lost["ros_failed"])
    heard_after = _until(lambda: send(messages[1]) or heard)
    print(json.dumps({"topic": "/failing", "failed": failed, "heard_after": heard_after}), flush=True)


def _message(made_message: tuple) -> bytes:
    _, msgtype, _, fields = made_message
    return CODEC.encode(made.build(CODEC.types, msgtype, fields, False))


def _until(done: Callable[[], object], timeout_s: float = 30.0) -> bool:
    deadline_s = time.monotonic() + timeout_s
    while not done():
        if time.monotonic() > deadline_s:
            return False
        time.sleep(0.02)
    return True


if __name__ == "__main__":
    main(int(sys.argv[1]))
