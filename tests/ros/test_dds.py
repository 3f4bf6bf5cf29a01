"""ROS 2's topics on the wire, by CycloneDDS, on loopback: what a ROS node would see of the agent, and the reverse."""

from __future__ import annotations

import importlib.util
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any, cast

import numpy as np
import pytest
from cyclonedds.core import DDSException, Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from edge_agent.ros import connect
from edge_agent.ros.codec import Codec
from edge_agent.ros.dds.graph import DdsGraph
from edge_agent.ros.dds.subscription import Subscription
from edge_agent.ros.dds.types import raw_type, ros_type_name
from edge_agent.ros.graph import RELIABLE, SAMPLES, STATIC, Delivery
from edge_agent.ros.settings import Ros2Settings
from splitslam.errors import InputError
from tests.ros.dds import DOMAIN, cyclonedds_uri
from tests.ros.idl_by_hand import Header_, Imu_, PointCloud2_, Quaternion_, Time_, Vector3_
from tests.sources import made_bags as made

CODEC = Codec("cdr")


@pytest.fixture
def join(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[], DdsGraph]]:
    monkeypatch.setenv("CYCLONEDDS_URI", cyclonedds_uri())
    with ExitStack() as stack:

        def one() -> DdsGraph:
            graph = DdsGraph(Ros2Settings(domain_id=DOMAIN))
            stack.callback(graph.close)
            return graph

        yield one


def eventually(condition: Callable[[], object], timeout_s: float = 30.0) -> None:
    deadline_s = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < deadline_s
        time.sleep(0.005)


def imu(k: int) -> bytes:
    _, msgtype, _, fields = made.imu(made.T0_NS + k, gyro=(0.1, 0.2, float(k)))
    return CODEC.encode(made.build(CODEC.types, msgtype, fields, False))


def cloud(points: int) -> bytes:
    layout = made.structured(np.ones((points, 3), np.float32), made.VELODYNE, 22)
    _, msgtype, _, fields = made.cloud(layout, made.T0_NS)
    return CODEC.encode(made.build(CODEC.types, msgtype, fields, False))


@pytest.mark.parametrize(("name", "by_hand"), [(made.IMU, Imu_), (made.CLOUD, PointCloud2_)])
def test_a_type_made_from_the_definition_is_the_one_written_by_hand(name: str, by_hand: type[IdlStruct]):
    ours = raw_type(name, CODEC.types)
    for kind in (ours, by_hand):
        kind.__idl__.populate()
        kind.__idl__.fill_type_data()
    assert ours.__idl__.idl_transformed_typename == by_hand.__idl__.idl_transformed_typename
    assert ours.__idl__.get_type_id() == by_hand.__idl__.get_type_id()


def test_a_message_arrives_as_the_bytes_it_was_sent_as_and_its_topic_is_found_by_its_ros_name(join):
    robot, agent = join(), join()
    send = robot.advertise("/imu/data", made.IMU, RELIABLE)
    heard: list[bytes] = []
    eventually(lambda: agent.topics() == {"/imu/data": made.IMU})
    assert robot.topics() == {}  # its own do not count
    agent.subscribe("/imu/data", made.IMU, SAMPLES, heard.append)
    eventually(lambda: send(imu(1)) or heard)
    assert CODEC.decode(heard[0], made.IMU).angular_velocity.z == 1.0
    assert heard[0] == imu(1)


def test_a_writer_that_knows_nothing_of_us_is_heard_best_effort_or_reliable(join):
    agent = join()
    participant = DomainParticipant(DOMAIN)
    for name, offer in (("best", Policy.Reliability.BestEffort), ("sure", Policy.Reliability.Reliable(10**9))):
        topic = Topic(participant, f"rt/{name}", Imu_)
        writer = DataWriter(participant, topic, Qos(offer, Policy.DataRepresentation(use_cdrv0_representation=True)))
        eventually(lambda at=f"/{name}": at in agent.topics())
        heard: list[bytes] = []
        agent.subscribe(f"/{name}", made.IMU, SAMPLES, heard.append)
        eventually(lambda of=writer: of.get_matched_subscriptions())
        zero, up, nine = Vector3_(0.0, 0.0, 0.0), Vector3_(0.0, 0.0, 9.8), cast(Any, [0.0] * 9)
        header = Header_(Time_(7, 8), "imu")
        by_hand = Imu_(header, Quaternion_(0.0, 0.0, 0.0, 1.0), nine, zero, nine, up, nine)
        eventually(lambda of=writer, sample=by_hand, got=heard: of.write(sample) or got)
        record = CODEC.decode(heard[0], made.IMU)
        assert (record.header.stamp.sec, record.header.frame_id, record.linear_acceleration.z) == (7, "imu", 9.8)


def test_a_best_effort_writer_that_comes_after_a_reliable_one_is_heard_as_well_and_each_message_once(join):
    agent, robot = join(), join()
    sure = robot.advertise("/imu/data", made.IMU, Delivery(keep=2000))
    heard: list[bytes] = []
    agent.subscribe("/imu/data", made.IMU, SAMPLES, heard.append)
    eventually(lambda: sure(imu(0)) or heard)
    participant = DomainParticipant(DOMAIN)
    topic = Topic(participant, "rt/imu/data", raw_type(made.IMU, CODEC.types))
    best = Qos(Policy.Reliability.BestEffort, Policy.DataRepresentation(use_cdrv0_representation=True))
    writer = DataWriter(participant, topic, best)
    eventually(lambda: writer.write(topic.data_type(imu(-1))) or imu(-1) in heard)
    for k in range(1, 200):
        sure(imu(k))
        writer.write(topic.data_type(imu(-1 - k)))
        time.sleep(0.001)
    eventually(lambda: imu(199) in heard)
    eventually(lambda: writer.write(topic.data_type(imu(-1000))) or imu(-1000) in heard)  # any of them may be lost
    numbers = [CODEC.decode(raw, made.IMU).angular_velocity.z for raw in heard]
    assert [number for number in numbers if number > 0] == [float(k) for k in range(1, 200)]
    best = [number for number in numbers if -1000 < number < -1]
    assert len(set(best)) == len(best) > 150


def test_what_is_offered_reliably_is_taken_reliably_and_arrives_whole_and_in_order(join):
    robot, agent = join(), join()
    send = robot.advertise("/imu/data", made.IMU, Delivery(keep=2000))
    heard: list[bytes] = []
    eventually(lambda: agent.topics())
    agent.subscribe("/imu/data", made.IMU, SAMPLES, heard.append)
    eventually(lambda: send(imu(0)) or heard)
    for k in range(1, 1000):
        send(imu(k))
    eventually(lambda: heard[-1] == imu(999))
    numbers = [CODEC.decode(raw, made.IMU).angular_velocity.z for raw in heard]
    assert numbers[-999:] == [float(k) for k in range(1, 1000)]
    assert agent.lost == {}


def test_a_message_that_the_reader_fails_at_costs_that_message_and_is_told_once(join, caplog: pytest.LogCaptureFixture):
    robot, agent = join(), join()
    send = robot.advertise("/imu/data", made.IMU, Delivery(keep=2000))
    heard: list[bytes] = []

    def receive(raw: bytes) -> None:
        if raw in (imu(3), imu(4)):
            raise ValueError("cannot be read")
        heard.append(raw)

    agent.subscribe("/imu/data", made.IMU, SAMPLES, receive)
    eventually(lambda: send(imu(0)) or heard)
    for k in range(1, 10):
        send(imu(k))
    eventually(lambda: heard[-1] == imu(9))
    numbers = [CODEC.decode(raw, made.IMU).angular_velocity.z for raw in heard]
    assert numbers[-7:] == [1.0, 2.0, 5.0, 6.0, 7.0, 8.0, 9.0]
    assert agent.lost == {"ros_failed": 2}
    (line,) = [record for record in caplog.records if record.message == "ROS messages fail"]
    assert "cannot be read" in str(line.exc_info)


def test_a_middleware_that_fails_is_asked_again(
    join, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
):
    robot, agent = join(), join()
    take, failures = Subscription.take, [DDSException(DDSException.DDS_RETCODE_ERROR)] * 2

    def fails_twice(subscription: Subscription) -> None:
        if failures:
            raise failures.pop()
        take(subscription)

    monkeypatch.setattr(Subscription, "take", fails_twice)
    send = robot.advertise("/imu/data", made.IMU, RELIABLE)
    heard: list[bytes] = []
    agent.subscribe("/imu/data", made.IMU, SAMPLES, heard.append)
    eventually(lambda: send(imu(1)) or heard)
    assert agent.lost == {"ros_failed": 2}
    assert [record.message for record in caplog.records].count("ROS messages fail") == 1


def test_a_latched_message_reaches_a_reader_that_comes_later(join):
    robot, agent = join(), join()
    robot.advertise("/tf_static", made.IMU, STATIC)(imu(5))
    heard: list[bytes] = []
    agent.subscribe("/tf_static", made.IMU, STATIC, heard.append)
    eventually(lambda: heard)


def test_a_reader_that_knows_nothing_of_us_understands_what_we_publish(join):
    agent = join()
    participant = DomainParticipant(DOMAIN)
    reader = DataReader(participant, Topic(participant, "rt/ours", Imu_), Qos(Policy.Reliability.Reliable(10**9)))
    send = agent.advertise("/ours", made.IMU, RELIABLE)
    heard: list[Imu_] = []
    eventually(lambda: send(imu(3)) or heard.extend(reader.take(10)) or heard)  # the writer may not know of it yet
    assert (heard[0].angular_velocity.z, heard[0].linear_acceleration.z) == (3.0, 9.8)


def test_a_cloud_is_decoded_in_a_small_part_of_the_time_that_the_middlewares_own_layer_takes():
    raw = cloud(26_000)

    def cpu_s(decode: Callable[[], object]) -> float:
        decode()
        began_s = time.thread_time()
        decode()
        return time.thread_time() - began_s

    kind = raw_type(made.CLOUD, CODEC.types)
    ours_s = min(cpu_s(lambda: CODEC.decode(kind.deserialize(raw).raw, made.CLOUD).data[0]) for _ in range(5))
    theirs_s = cpu_s(lambda: PointCloud2_.deserialize(raw))
    print(f"ours {1e3 * ours_s:.2f} ms, CycloneDDS's Python layer {1e3 * theirs_s:.2f} ms")
    assert ours_s < 0.1 * theirs_s


def test_types_that_are_not_messages_are_passed_over():
    assert ros_type_name("sensor_msgs::msg::dds_::Imu_") == made.IMU
    for name in ("example_interfaces::srv::dds_::AddTwoInts_Request_", "rmw_dds_common::msg::Graph", "Imu"):
        assert ros_type_name(name) is None


@pytest.mark.parametrize("text", ["233", "-1", "seven"])
def test_a_domain_that_is_none_is_refused(text: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", text)
    with pytest.raises(InputError, match=rf"^ROS_DOMAIN_ID={text}: expected a number from 0 to 232$"):
        DdsGraph(Ros2Settings())


def test_without_any_way_into_a_graph_the_error_names_both(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"neither rclpy nor cyclonedds is there: expected .* splitslam\[ros2\]$"):
        connect.join(Ros2Settings(), threading.Event())
