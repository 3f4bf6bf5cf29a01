"""What sensors in a graph say becomes events, of which nothing is lost or made up."""

from __future__ import annotations

import threading
import time
from typing import Any, Literal

import numpy as np
import pytest

from edge_agent.ros import messages
from edge_agent.ros.settings import Ros2Settings, RosSettings
from edge_agent.ros.source import RosSource
from edge_agent.sources import open_recording
from edge_agent.sources.source import Event
from splitslam import se3
from splitslam.errors import InputError
from splitslam.robot import robot_from_yaml
from splitslam.scan import GnssFix, ImuSamples, Scan, WheelSamples
from tests.ros.fake_graph import FakeGraph
from tests.sources import made_bags as made
from tests.sources.robots import RIGID

CLOUDS, SAMPLES, FIXES, WHEELS = "/points_raw", "/imu_raw", "/gps/fix", "/wheel/odom"
TYPES = {CLOUDS: made.CLOUD, SAMPLES: made.IMU, FIXES: made.FIX, WHEELS: made.ODOMETRY}
FRAMES = {CLOUDS: "velodyne", SAMPLES: "imu_link", FIXES: "antenna"}
PLACED = robot_from_yaml(
    f"lidar: {{beam_elevations_deg: [-10, 0, 10]}}\n{RIGID}\nT_body_lidar: {RIGID.split(': ')[1]}\n"
)
EDGES = [
    ("base_link", "velodyne", se3.compose(se3.so3_exp(np.array([0.0, 0.1, 0.0])), np.array([0.2, 0.0, 0.5]))),
    ("base_link", "imu_link", se3.compose(se3.so3_exp(np.array([0.0, 0.0, np.pi])), np.array([-0.1, 0.0, 0.1]))),
    ("velodyne", "antenna", se3.compose(np.eye(3), np.array([0.0, 0.3, 0.2]))),
]

pytestmark = pytest.mark.usefixtures("impatient")


class Robot(FakeGraph):
    """Sensors that publish as soon as somebody listens to them."""

    def __init__(self, encoding: Literal["ros1", "cdr"] = "cdr", topics: tuple[str, ...] = (CLOUDS, SAMPLES)) -> None:
        super().__init__(encoding, {topic: TYPES[topic] for topic in topics})
        self.static: list[tuple[str, str, np.ndarray]] = []
        self.on_subscribe = self._publish_first

    def _publish_first(self, topic: str) -> None:
        if topic == "/tf_static" and self.static:
            self.say(topic, messages.transforms(self.codec, 0, self.static))
        if topic in self.there:
            self.publish(topic, 0)

    def publish(self, topic: str, k: int, at: str | None = None) -> None:
        stamp_ns = made.T0_NS + k * 100_000_000
        one: dict[str, made.Message] = {
            CLOUDS: cloud(stamp_ns),
            SAMPLES: made.imu(stamp_ns),
            FIXES: made.fix(stamp_ns),
            WHEELS: made.wheels(stamp_ns),
        }
        _, msgtype, _, fields = one[topic]
        record = made.build(self.codec.types, msgtype, fields, self.codec.encoding == "ros1")
        record.header.frame_id = FRAMES.get(topic, "odom")
        self.say(at or topic, record)


def cloud(stamp_ns: int) -> made.Message:
    xyz, ring, fraction = made.turn()
    return made.cloud(made.structured(xyz, made.VELODYNE, 22, ring=ring, time=fraction * 0.1), stamp_ns)


def source(graph: FakeGraph, of: Any = PLACED, ros: RosSettings | None = None, **settings: Any) -> RosSource:
    values = {"wait_s": 0.3, "end_after_s": 0.3, **settings}
    return RosSource(graph, Ros2Settings(**values), ros or RosSettings(), of, threading.Event())


def events(of: RosSource) -> list[Event]:
    return [timed[1] for timed in of.events() if timed is not None]


@pytest.mark.parametrize("encoding", ["ros1", "cdr"])
def test_messages_become_the_events_that_a_recording_of_them_gives(encoding: Literal["ros1", "cdr"], tmp_path):
    graph = Robot(encoding, (CLOUDS, SAMPLES, FIXES, WHEELS))
    with_wheels = robot_from_yaml(f"lidar: {{rings: 3}}\nwheels: {{}}\n{RIGID}")
    live = source(graph, with_wheels)
    for k in range(1, 4):
        for topic in TYPES:
            graph.publish(topic, k)
    recorded = [
        message
        for k in range(4)
        for stamp_ns in [made.T0_NS + k * 100_000_000]
        for message in (cloud(stamp_ns), made.imu(stamp_ns), made.fix(stamp_ns), made.wheels(stamp_ns))
    ]
    kind = made.ROS1 if encoding == "ros1" else made.SQLITE3
    reference = [event for _, event in open_recording(made.write_bag(tmp_path, kind, recorded), with_wheels).events()]
    heard = events(live)
    for kind in (Scan, ImuSamples, GnssFix, WheelSamples):
        ours, theirs = ([e for e in some if isinstance(e, kind)] for some in (heard, reference))
        assert len(ours) == len(theirs) == 4
        for one, other in zip(ours, theirs, strict=True):
            for name in kind.__dataclass_fields__:
                np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert live.counts.scans_read == 4
    assert live.dropped == {}


def test_arrivals_are_on_a_clock_that_looks_like_unix_time_and_never_steps():
    live = source(Robot())
    before_ns = time.time_ns()
    arrivals_ns = [timed[0] for timed in live.events() if timed is not None]
    assert all(abs(arrival_ns - before_ns) < 10 * 10**9 for arrival_ns in arrivals_ns)
    assert (live.start_ns, live.end_ns) == (arrivals_ns[0], arrivals_ns[-1])


def test_the_agents_own_topics_are_there_before_the_sensors_and_diagnostics_say_what_it_waits_for():
    graph = FakeGraph()
    with pytest.raises(InputError):
        source(graph)
    assert graph.advertised == ["/tf", "/splitslam/odometry", "/diagnostics"]
    assert graph.sent["/diagnostics"][0].status[0].message == "waiting for lidar"
    assert graph.sent["/diagnostics"][0].status[0].level == messages.WARN


def test_a_middleware_that_takes_no_diagnostics_does_not_end_the_wait_for_the_sensors():
    graph = FakeGraph()
    graph.broken = True
    with pytest.raises(InputError, match="no scans: expected a topic"):
        source(graph)
    assert graph.lost["ros_not_sent"] > 0


def test_an_agent_that_publishes_nothing_has_no_topics():
    graph = Robot()
    source(graph, ros=RosSettings(publish=False))
    assert graph.advertised == []


def test_a_source_that_is_silent_says_so_and_goes_on_until_it_is_closed():
    live = source(Robot(), end_after_s=None)
    quiet = 0
    for timed in live.events():
        quiet += timed is None
        if quiet == 3:
            live.close()
    assert quiet == 3
    assert live.graph.closed  # pyright: ignore[reportAttributeAccessIssue]


def test_what_does_not_parse_is_dropped_and_counted():
    graph = Robot()
    live = source(graph)
    for receive in graph.receivers[SAMPLES]:
        receive(b"\x00\x01\x00\x00nothing")
    graph.publish(SAMPLES, 1)
    assert len([e for e in events(live) if isinstance(e, ImuSamples)]) == 2
    assert live.dropped == {"decode": 1}


def test_messages_that_nobody_takes_are_bounded_in_bytes_and_those_that_go_are_counted():
    graph = Robot()
    live = source(graph, queue_bytes=2**20)
    size = len(graph.codec.encode(made.build(graph.codec.types, *_record(cloud(made.T0_NS)), False)))
    count = 2 * 2**20 // size
    for k in range(1, count + 1):
        graph.publish(CLOUDS, k)
    scans = [e for e in events(live) if isinstance(e, Scan)]
    assert abs(len(scans) - 2**20 // size) <= 1
    assert scans[-1].stamp_ns == made.T0_NS + count * 100_000_000
    assert live.dropped["ros_inbox_full"] == count + 2 - len(scans)  # the first scan, and the sample before it, too


def _record(message: made.Message) -> tuple[str, dict[str, Any]]:
    return message[1], message[3]


def test_the_tap_sees_every_message_as_it_came_with_its_definition():
    live = source(Robot())
    seen = []
    live.tap = lambda stream, arrival_ns, raw: seen.append((stream, raw))
    events(live)
    assert {stream.topic for stream, _ in seen} == {CLOUDS, SAMPLES}
    assert all(stream.encoding == "cdr" and "Header header" in stream.definition for stream, _ in seen)
    assert live.graph.codec.decode(seen[0][1], seen[0][0].msgtype) is not None


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"namespace": "a b"}, "expected a ROS name"),
        ({"domain_id": 300}, "less than or equal to 232"),
        ({"via": "fastdds"}, "cyclonedds"),
    ],
)
def test_a_graph_that_cannot_be_is_refused(values: dict[str, Any], says: str):
    with pytest.raises(ValueError, match=says):
        Ros2Settings(**values)


def test_frames_must_differ():
    with pytest.raises(ValueError, match="expected three names"):
        RosSettings(odom_frame="map")


def test_scans_that_never_come_are_counted_by_the_gap_that_they_leave():
    graph = Robot()
    live = source(graph)
    for k in [*range(1, 30), *range(33, 60)]:
        graph.publish(CLOUDS, k)
    events(live)
    assert live.dropped == {"ros_scan_missing": 3}
