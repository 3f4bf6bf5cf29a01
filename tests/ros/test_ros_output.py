"""What the agent says to a graph: frames as REP-105, one owner of the base, nothing that could hold up the pipeline."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from edge_agent.ros import messages
from edge_agent.ros.base_samples import Belief
from edge_agent.ros.outlets import Outlets
from edge_agent.ros.output import RosOutput
from edge_agent.ros.settings import Ros2Settings, RosSettings
from edge_agent.ros.tf_buffer import transform_of
from edge_agent.sources.messages import stamp_ns
from edge_agent.types import OdomPoses
from splitslam import se3
from splitslam.robot import robot_from_yaml
from tests.ros.fake_graph import FakeGraph

T_BODY_LIDAR = se3.compose(se3.so3_exp(np.array([0.1, -0.2, 0.5])), np.array([0.3, -0.1, 0.4]))
ROBOT = robot_from_yaml(f"{{robot: {{id: rover}}, imu: null, T_body_lidar: {T_BODY_LIDAR.tolist()}}}")
T0_NS = 1_700_000_000_000_000_000
STEP_NS = 2_000_000
SPEED_MPS, TURN_RADPS = 1.5, 0.7


@dataclass
class Imu:
    T_map_odom: np.ndarray = field(
        default_factory=lambda: se3.compose(se3.so3_exp(np.array([0.0, 0.0, 0.3])), np.array([5.0, -2.0, 0.1]))
    )
    covariance: np.ndarray = field(default_factory=lambda: np.diag([1e-6, 2e-6, 3e-6, 1e-4, 2e-4, 3e-4]))
    velocity_covariance: np.ndarray = field(default_factory=lambda: np.diag([0.01, 0.02, 0.03]))


@dataclass
class Stage:
    """An output in a graph. offset_ns, state: as the pipeline has them."""

    graph: FakeGraph
    stack: ExitStack
    imu: Imu = field(default_factory=Imu)
    state: int = 2
    offset_ns: int = 0

    def output(self, **settings: Any) -> RosOutput:
        belief = Belief(self.imu, lambda: self.state, lambda: self.offset_ns)
        values = {"diagnostics_hz": 1000.0, **settings}
        ros = RosSettings(**values)
        outlets = Outlets(self.graph, Ros2Settings(), ros, ROBOT.robot.id)
        output = RosOutput(ros, outlets, ROBOT, belief, lambda: {"connected": True})
        self.stack.callback(output.close)
        return output

    def tf(self) -> list[Any]:
        return self.graph.sent["/tf"]


@pytest.fixture(params=["cdr", "ros1"])
def stage(request: pytest.FixtureRequest) -> Iterator[Stage]:
    with ExitStack() as stack:
        yield Stage(FakeGraph(request.param), stack)


def circle(k: float) -> np.ndarray:
    """T_odom_base after k steps: forward and to the left."""
    return se3.exp(np.array([0.0, 0.0, TURN_RADPS, SPEED_MPS, 0.0, 0.0]) * k * STEP_NS * 1e-9)


def poses(first: int, count: int) -> OdomPoses:
    lidar = [circle(k) @ T_BODY_LIDAR for k in range(first, first + count)]
    return OdomPoses(
        T0_NS + STEP_NS * np.arange(first, first + count, dtype=np.int64),
        np.array([T[:3, 3] for T in lidar]),
        np.array([se3.quat_from_matrix(T[:3, :3]) for T in lidar]),
        np.zeros((count, 3)),
    )


def eventually(condition: Callable[[], bool], timeout_s: float = 30.0) -> None:
    deadline_s = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < deadline_s
        time.sleep(0.002)


def placed(message: Any) -> dict[tuple[str, str], np.ndarray]:
    found = {}
    for stamped in message.transforms:
        T = transform_of(stamped.transform)
        assert T is not None
        found[stamped.header.frame_id, stamped.child_frame_id] = T
    return found


def step_of(message: Any) -> int:
    return (stamp_ns(message.transforms[0].header) - T0_NS) // STEP_NS


def other_odometry(stage: Stage, first: int, count: int, child: str = "base_link") -> None:
    """Another node's odometry, 1 m beside ours."""
    codec = stage.graph.codec
    for k in range(first, first + count, 5):
        T = se3.compose(np.eye(3), np.array([0.0, 1.0, 0.0])) @ circle(k)
        stage.graph.say("/tf", messages.transforms(codec, T0_NS + k * STEP_NS, [("odom", child, T)]))


def test_the_tree_is_map_odom_base_and_its_product_is_where_the_base_is_in_the_map(stage: Stage):
    output = stage.output(rate_hz=50.0)
    output.publish(poses(0, 500))
    output.close()  # sends what is in the queue
    for message in stage.tf():
        found = placed(message)
        assert list(found) == [("map", "odom"), ("odom", "base_link")]
        assert len({stamp_ns(stamped.header) for stamped in message.transforms}) == 1
        T_map_base = found["map", "odom"] @ found["odom", "base_link"]
        np.testing.assert_allclose(T_map_base, stage.imu.T_map_odom @ circle(step_of(message)), atol=1e-9)
    assert len(stage.tf()) == 49  # 50 Hz of one second, the first for want of a speed not


def test_odometry_has_the_base_in_odom_and_its_speed_in_the_base(stage: Stage):
    stage.output().publish(poses(0, 100))
    sent = stage.graph.sent["/splitslam/odometry"]
    eventually(lambda: len(sent) >= 5)
    for message in sent:
        assert (message.header.frame_id, message.child_frame_id) == ("odom", "base_link")
        speed, turn = message.twist.twist.linear, message.twist.twist.angular
        assert (speed.x, speed.y, speed.z) == pytest.approx((SPEED_MPS, 0.0, 0.0), abs=1e-6)
        assert (turn.x, turn.y, turn.z) == pytest.approx((0.0, 0.0, TURN_RADPS), abs=1e-6)
        twist = message.twist.covariance.reshape(6, 6)
        assert np.trace(twist[:3, :3]) == pytest.approx(0.06)
        assert (np.linalg.eigvalsh(twist) > 0).all()


def test_the_covariance_of_the_pose_is_about_the_axes_of_odom_translation_first(stage: Stage):
    stage.output().publish(poses(700, 20))  # after a radian
    sent = stage.graph.sent["/splitslam/odometry"]
    eventually(lambda: bool(sent))
    stated = sent[0].pose.covariance.reshape(6, 6)
    T_odom_base = circle((stamp_ns(sent[0].header) - T0_NS) // STEP_NS)
    generator = np.random.default_rng(1)
    errors = []
    for xi in generator.multivariate_normal(np.zeros(6), stage.imu.covariance, 20000):  # of the LiDAR, its own axes
        T = T_odom_base @ T_BODY_LIDAR @ se3.exp(xi) @ se3.inv(T_BODY_LIDAR)
        turned = se3.so3_log(T[:3, :3] @ T_odom_base[:3, :3].T)
        errors.append([*(T[:3, 3] - T_odom_base[:3, 3]), *turned])
    seen = np.cov(np.array(errors).T)
    scale = np.sqrt(np.outer(np.diag(stated), np.diag(stated)))
    np.testing.assert_allclose(seen / scale, stated / scale, atol=0.03)


def test_with_another_owner_of_odom_only_map_to_odom_goes_out_and_leads_to_the_same_place(stage: Stage):
    output = stage.output(publish_odom_tf=False)
    other_odometry(stage, 0, 300)
    sent_by_other = len(stage.tf())
    output.publish(poses(0, 250))
    output.close()  # sends what is in the queue
    ours = stage.tf()[sent_by_other:]
    assert len(ours) == len(stage.graph.sent["/splitslam/odometry"]) >= 20
    for message in ours:
        found = placed(message)
        assert list(found) == [("map", "odom")]
        other = se3.compose(np.eye(3), np.array([0.0, 1.0, 0.0])) @ circle(step_of(message))
        here = stage.imu.T_map_odom @ circle(step_of(message))
        np.testing.assert_allclose(found["map", "odom"] @ other, here, atol=1e-5)  # interpolated
    assert stage.graph.sent["/splitslam/odometry"][0].header.frame_id == "map"


def test_a_pose_that_is_ahead_of_the_other_odometry_waits_for_it(stage: Stage):
    output = stage.output(publish_odom_tf=False)
    output.publish(poses(0, 100))
    eventually(lambda: len(stage.graph.sent["/splitslam/odometry"]) >= 9)
    assert stage.tf() == []
    other_odometry(stage, 0, 101)
    output.publish(poses(100, 11))
    eventually(lambda: bool(stage.tf()))
    assert step_of(stage.tf()[-1]) == 100


def test_the_agent_stops_placing_the_base_when_another_node_does(stage: Stage):
    output = stage.output()
    output.publish(poses(0, 20))
    eventually(lambda: bool(stage.tf()))
    other_odometry(stage, 20, 200)
    before = len(stage.tf())
    output.publish(poses(20, 100))
    eventually(lambda: len(stage.tf()) > before)
    assert all(list(placed(message)) == [("map", "odom")] for message in stage.tf()[before:])
    eventually(lambda: "another node places base_link" in stage.graph.sent["/diagnostics"][-1].status[0].message)
    assert int(stage.graph.sent["/diagnostics"][-1].status[0].level) == messages.ERROR


def test_its_own_transforms_that_come_back_are_not_taken_for_anothers(stage: Stage):
    output = stage.output(rate_hz=0.0, queue=2000)
    output.publish(poses(0, 1000))
    eventually(lambda: len(stage.tf()) == 999)
    assert all(len(message.transforms) == 2 for message in stage.tf())


def test_stamps_are_those_of_the_sensors_after_their_clock_has_stepped(stage: Stage):
    stage.offset_ns = 3600 * 10**9
    stage.output().publish(poses(0, 20))
    eventually(lambda: bool(stage.tf()))
    assert stamp_ns(stage.tf()[0].transforms[0].header) == T0_NS + 10 * STEP_NS - 3600 * 10**9


@pytest.mark.parametrize(("state", "level", "text"), [(2, 0, "tracking"), (3, 1, "degenerate"), (6, 2, "lost")])
def test_diagnostics_say_how_it_goes(stage: Stage, state: int, level: int, text: str):
    stage.state = state
    stage.output().publish(poses(0, 20))
    sent = stage.graph.sent["/diagnostics"]
    eventually(lambda: bool(sent) and sent[-1].status[0].message == text)
    status = sent[-1].status[0]
    assert (int(status.level), status.name, status.hardware_id) == (level, "splitslam: tracking", "rover")
    assert {pair.key: pair.value for pair in status.values}["connected"] == "True"


def test_a_stop_is_said_in_the_diagnostics(stage: Stage):
    output = stage.output()
    output.close()
    output.close()
    assert stage.graph.sent["/diagnostics"][-1].status[0].message == "stopped"


def test_a_graph_that_blocks_costs_samples_which_are_counted_and_the_pipeline_never_waits():
    blocked, graph = threading.Event(), FakeGraph()
    with ExitStack() as stack:
        graph.receivers["/tf"].append(lambda raw: (blocked.wait(60.0), None)[1])
        output = Stage(graph, stack).output(rate_hz=0.0, queue=50)
        stack.callback(blocked.set)
        began_s = time.thread_time()
        output.publish(poses(0, 1000))
        assert time.thread_time() - began_s < 5.0
        eventually(lambda: output.dropped["ros_queue_full"] >= 800)
        blocked.set()
        output.close()
        assert output.dropped["ros_queue_full"] + len(graph.sent["/tf"]) == 999


def test_a_graph_that_fails_costs_messages_which_are_counted_and_comes_back(stage: Stage):
    output = stage.output()
    stage.graph.broken = True
    output.publish(poses(0, 100))
    eventually(lambda: output.dropped["ros_not_sent"] >= 9)
    stage.graph.broken = False
    output.publish(poses(100, 100))
    eventually(lambda: bool(stage.tf()))


def test_names_and_namespace_are_the_configurations():
    with ExitStack() as stack:
        graph = FakeGraph()
        belief = Belief(Imu(), lambda: 2, lambda: 0)
        settings = RosSettings(
            map_frame="world", odom_frame="r1/odom", base_frame="/r1/base", odometry="odom", tf="tf", rate_hz=0
        )
        outlets = Outlets(graph, Ros2Settings(namespace="/r1/"), settings, ROBOT.robot.id)
        output = RosOutput(settings, outlets, ROBOT, belief, dict)
        stack.callback(output.close)
        output.publish(poses(0, 3))
        eventually(lambda: bool(graph.sent["/r1/odom"]))
        assert list(placed(graph.sent["/r1/tf"][0])) == [("world", "r1/odom"), ("r1/odom", "r1/base")]
