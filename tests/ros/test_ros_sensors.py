"""Which topics of a graph are the robot's sensors, and where they sit."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest

from edge_agent.ros.settings import Ros2Settings, RosSettings
from edge_agent.ros.source import RosSource
from edge_agent.sources.source import StoppedError
from splitslam import se3
from splitslam.errors import InputError
from splitslam.robot import load_robot, robot_from_yaml
from splitslam.scan import GnssFix
from tests.ros.test_ros_source import CLOUDS, EDGES, FIXES, PLACED, SAMPLES, Robot, events, source
from tests.sources import made_bags as made
from tests.sources.robots import RIGID, robot

pytestmark = pytest.mark.usefixtures("impatient")


def test_in_a_namespace_the_usual_names_are_looked_for_there():
    graph = Robot(topics=())
    graph.there = {
        "/points_raw": made.CLOUD,
        "/r2/points_raw": made.CLOUD,
        "/r2/imu_raw": made.IMU,
        "/imu/data": made.IMU,
    }
    graph.on_subscribe = lambda at: graph.publish(f"/{at.rsplit('/', 1)[1]}", 0, at) if at.startswith("/r2") else None
    assert source(graph, namespace="r2").topics == {"lidar": "/r2/points_raw", "imu": "/r2/imu_raw"}


def test_a_relative_name_in_the_robot_file_is_in_the_namespace_and_one_with_a_slash_is_not():
    graph = Robot(topics=())
    graph.there = {"/r2/cloud": made.CLOUD, "/shared_imu": made.IMU}
    graph.on_subscribe = lambda at: (
        graph.publish({"/r2/cloud": CLOUDS, "/shared_imu": SAMPLES}[at], 0, at) if at in graph.there else None
    )
    named = robot_from_yaml(f"lidar: {{rings: 3, topic: cloud}}\nimu: {{topic: /shared_imu}}\n{RIGID}")
    assert source(graph, named, namespace="r2").topics == {"lidar": "/r2/cloud", "imu": "/shared_imu"}


def test_a_lidar_that_turns_up_late_is_waited_for():
    graph = Robot()
    there, graph.there = graph.there, {}
    threading.Timer(0.3, lambda: graph.there.update(there)).start()
    assert source(graph, wait_s=10.0).topics["lidar"] == CLOUDS


def test_without_a_lidar_the_error_says_what_there_is():
    with pytest.raises(InputError, match=r"^a graph: no scans: expected .*there are: /imu_raw \(sensor_msgs/Imu\)$"):
        source(Robot(topics=(SAMPLES,)))


def test_a_named_lidar_that_does_not_come_is_named_in_the_error():
    with pytest.raises(InputError, match=r"^a graph: lidar.topic: no topic /cloud; there are: "):
        source(Robot(), robot("rings: 3, topic: /cloud"))


def test_a_topic_of_another_type_is_an_error_at_once():
    began_s = time.monotonic()
    with pytest.raises(InputError, match=r"lidar.topic: /imu_raw is sensor_msgs/Imu, expected sensor_msgs/PointCloud2"):
        source(Robot(), robot("rings: 3, topic: /imu_raw"), wait_s=60.0)
    assert time.monotonic() - began_s < 30.0


def test_a_named_sensor_that_nobody_publishes_yet_is_listened_to_all_the_same():
    graph = Robot()
    named = robot_from_yaml(f"lidar: {{rings: 3}}\ngnss: {{topic: /late, t_lidar_antenna_m: [0, 0, 0]}}\n{RIGID}")
    live = source(graph, named)
    graph.publish(FIXES, 1, "/late")
    assert any(isinstance(event, GnssFix) for event in events(live))
    assert "gnss: nobody publishes /late yet" in live.notes


def test_topics_without_a_scan_end_with_an_error_that_names_the_topic():
    graph = Robot()
    graph.on_subscribe = lambda at: None
    with pytest.raises(InputError, match=r"^a graph: /points_raw: no scan has come"):
        source(graph)


def test_the_wait_for_sensors_ends_when_the_agent_is_stopped():
    stop = threading.Event()
    threading.Timer(0.2, stop.set).start()
    with pytest.raises(StoppedError):
        RosSource(Robot(topics=()), Ros2Settings(), RosSettings(), PLACED, stop)


def test_places_that_the_robot_file_leaves_open_come_from_tf_static():
    graph = Robot(topics=(CLOUDS, SAMPLES, FIXES))
    graph.static = EDGES
    live = source(graph, robot_from_yaml("lidar: {rings: 3}"))
    T_base_lidar, T_base_imu, T_lidar_antenna = (T for _, _, T in EDGES)
    np.testing.assert_allclose(live.robot.T_body_lidar, T_base_lidar, atol=1e-9)
    np.testing.assert_allclose(live.robot.T_lidar_imu, se3.inv(T_base_lidar) @ T_base_imu, atol=1e-9)
    assert live.robot.gnss is not None
    assert live.robot.gnss.t_lidar_antenna_m == pytest.approx(tuple(T_lidar_antenna[:3, 3]))
    assert live.robot.imu_placed
    assert "T_lidar_imu: velodyne <- imu_link, by /tf_static" in live.notes


def test_what_the_robot_file_says_counts_more_than_tf_static():
    graph = Robot()
    graph.static = EDGES
    live = source(graph)
    np.testing.assert_array_equal(live.robot.T_lidar_imu, np.eye(4))
    np.testing.assert_array_equal(live.robot.T_body_lidar, np.eye(4))


def test_an_imu_that_nobody_places_is_an_error():
    with pytest.raises(
        InputError, match=r"T_lidar_imu: must be given.*does not connect the frames velodyne and imu_link"
    ):
        source(Robot(), robot_from_yaml("lidar: {rings: 3}"))


def test_a_robot_file_that_names_its_imu_may_leave_its_place_to_the_graph(tmp_path):
    path = tmp_path / "robot.yaml"
    path.write_text("lidar: {rings: 3}\nimu: {topic: /imu_raw, rate_hz: 200}\n")
    with pytest.raises(InputError, match="T_lidar_imu: must be given"):
        load_robot(path)
    graph = Robot()
    graph.static = EDGES
    live = source(graph, load_robot(path, placed_elsewhere=True))
    assert live.robot.imu is not None
    assert live.robot.imu.rate_hz == 200
    assert live.topics["imu"] == SAMPLES
    assert live.robot.imu_placed


def test_several_lidars_and_none_usual_must_be_told_apart():
    graph = Robot()
    graph.there = {"/front": made.CLOUD, "/rear": made.CLOUD}
    with pytest.raises(InputError, match=r"^a graph: lidar.topic: must be given, one of: /front, /rear$"):
        source(graph, wait_s=None)
