"""`python -m tests.ros.play_dds BAG SECONDS DOMAIN [OFFER]`: a ROS 1 bag's topics as ROS 2 topics, over CycloneDDS.

OFFER: reliable (default) or best-effort. Waits until somebody listens to LiDAR and IMU, plays at the bag's pace, and
prints how many messages of each it has sent, as JSON.
"""

from __future__ import annotations

import json
import sys
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.topic import Topic
from cyclonedds.util import duration
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores

from edge_agent.ros.dds.types import raw_type
from edge_agent.sources import topics
from edge_agent.sources.bag import typestore

_LISTENERS_S = 60.0
_KEEP = 1000
_NEEDED = (topics.POINT_CLOUD, topics.VELODYNE_SCAN, topics.IMU)


def main(bag: Path, seconds: float, domain: int, offered: str = "reliable") -> None:
    participant = DomainParticipant(domain)
    types = typestore()
    reliable = Policy.Reliability.Reliable(duration(seconds=1))
    offer = reliable if offered == "reliable" else Policy.Reliability.BestEffort
    qos = Qos(offer, Policy.History.KeepLast(_KEEP), Policy.DataRepresentation(use_cdrv0_representation=True))
    sent: Counter[str] = Counter()
    with AnyReader([bag], default_typestore=typestore(Stores.ROS1_NOETIC)) as reader:
        writers = {}
        for connection in reader.connections:
            topic = Topic(participant, f"rt{connection.topic}", raw_type(connection.msgtype, types))
            writers[connection.topic] = DataWriter(participant, topic, qos)
        _wait_for([writers[one.topic] for one in reader.connections if one.msgtype in _NEEDED])
        began_s = time.monotonic()
        for topic, after_s, msgtype, raw in _messages(reader, seconds):
            time.sleep(max(began_s + after_s - time.monotonic(), 0.0))
            writer = writers[topic]
            writer.write(writer.data_type(bytes(types.ros1_to_cdr(raw, msgtype))))
            sent[topic] += 1
        for writer in writers.values():
            writer.wait_for_acks(duration(seconds=5))
    print(json.dumps(sent), flush=True)


def _messages(reader: AnyReader, seconds: float) -> Iterator[tuple[str, float, str, bytes]]:
    first_ns: int | None = None
    for connection, arrival_ns, raw in reader.messages():
        first_ns = arrival_ns if first_ns is None else first_ns
        after_s = (arrival_ns - first_ns) * 1e-9
        if after_s > seconds:
            return
        yield connection.topic, after_s, connection.msgtype, raw


def _wait_for(writers) -> None:
    deadline_s = time.monotonic() + _LISTENERS_S
    while not all(writer.get_matched_subscriptions() for writer in writers):
        if time.monotonic() > deadline_s:
            sys.exit("nobody listens")
        time.sleep(0.02)


if __name__ == "__main__":
    main(Path(sys.argv[1]), float(sys.argv[2]), int(sys.argv[3]), *sys.argv[4:])
