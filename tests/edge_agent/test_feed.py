from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path

import grpc
import numpy as np
import pytest

from edge_agent.config import FeedConfig
from edge_agent.feed import PoseFeed
from edge_agent.metrics import EdgeMetrics
from edge_agent.types import OdomPoses
from edge_agent.wire import matrix
from splitslam import se3
from splitslam.errors import InputError
from splitslam.wire import local_pb2 as pb
from splitslam.wire import local_pb2_grpc as rpc

WAIT_S = 30.0
T_BODY_LIDAR = se3.compose(se3.so3_exp(np.array([0.0, 0.0, 0.5])), np.array([0.2, 0.0, 0.4]))


@pytest.fixture
def metrics() -> EdgeMetrics:
    return EdgeMetrics()


@pytest.fixture
def feed(tmp_path: Path, metrics: EdgeMetrics) -> Iterator[PoseFeed]:
    feed = PoseFeed(FeedConfig(queue_samples=50), tmp_path / "pose.sock", T_BODY_LIDAR, metrics)
    yield feed
    feed.close()


def poses(start_ns: int, count: int, step_ns: int = 2_000_000) -> OdomPoses:
    """1 m/s along x of odom, heading constant."""
    stamps_ns = start_ns + step_ns * np.arange(count, dtype=np.int64)
    positions = np.zeros((count, 3))
    positions[:, 0] = stamps_ns * 1e-9
    quats = np.tile([0.0, 0.0, 0.0, 1.0], (count, 1))
    return OdomPoses(stamps_ns, positions, quats, np.tile([1.0, 0.0, 0.0], (count, 1)))


class Watcher(threading.Thread):
    """One client; collects until its channel is closed."""

    def __init__(self, path: Path, max_rate_hz: float = 0.0) -> None:
        super().__init__(daemon=True)
        self.channel = grpc.insecure_channel(f"unix:{path}")
        self.call = rpc.LocalPoseServiceStub(self.channel).Watch(pb.WatchRequest(max_rate_hz=max_rate_hz))
        self.samples: list[pb.WatchResponse] = []
        self.start()

    def run(self) -> None:
        try:
            for sample in self.call:
                self.samples.append(sample)
        except grpc.RpcError:
            pass

    def wait(self, count: int) -> None:
        deadline_s = time.monotonic() + WAIT_S
        while len(self.samples) < count and time.monotonic() < deadline_s:
            time.sleep(0.01)


def wait_for_readers(metrics: EdgeMetrics, count: int) -> None:
    deadline_s = time.monotonic() + WAIT_S
    while metrics.feed_readers.values()[()] != count and time.monotonic() < deadline_s:
        time.sleep(0.01)


def test_a_watcher_gets_every_imu_sample_as_the_body_s_pose(tmp_path: Path, feed: PoseFeed, metrics: EdgeMetrics):
    watcher = Watcher(tmp_path / "pose.sock")
    wait_for_readers(metrics, 1)
    T_map_odom = se3.compose(np.eye(3), np.array([1.0, 2.0, 3.0]))
    for k in range(10):
        feed.publish(poses(k * 10_000_000, 5), T_map_odom, np.eye(6), state=2)
    watcher.wait(50)
    watcher.channel.close()
    assert [s.stamp_ns for s in watcher.samples] == list(range(0, 100_000_000, 2_000_000))
    last = watcher.samples[-1]
    T_odom_lidar = se3.compose(np.eye(3), np.array([0.098, 0.0, 0.0]))
    np.testing.assert_allclose(matrix(last.pose_odom_body), T_odom_lidar @ se3.inv(T_BODY_LIDAR), atol=1e-9)
    np.testing.assert_allclose(matrix(last.pose_map_odom), T_map_odom)
    velocity_odom = matrix(last.pose_odom_body)[:3, :3] @ [last.vx_mps, last.vy_mps, last.vz_mps]
    np.testing.assert_allclose(velocity_odom, [1.0, 0.0, 0.0], atol=1e-6)
    assert (last.state, len(last.covariance)) == (2, 36)


def test_a_watcher_gets_no_more_than_the_rate_it_asked_for(tmp_path: Path, feed: PoseFeed, metrics: EdgeMetrics):
    watcher = Watcher(tmp_path / "pose.sock", max_rate_hz=30.0)
    wait_for_readers(metrics, 1)
    for k in range(100):
        feed.publish(poses(10**18 + k * 10_000_000, 5), np.eye(4), np.eye(6), 2)
        time.sleep(0.001)
    watcher.wait(30)
    watcher.channel.close()
    assert 28 <= len(watcher.samples) <= 31


def test_a_slow_watcher_loses_samples_that_are_counted_and_nobody_waits(
    tmp_path: Path, feed: PoseFeed, metrics: EdgeMetrics
):
    channel = grpc.insecure_channel(f"unix:{tmp_path / 'pose.sock'}")
    call = rpc.LocalPoseServiceStub(channel).Watch(pb.WatchRequest())  # never read
    wait_for_readers(metrics, 1)
    started_s = time.monotonic()
    for k in range(40):
        feed.publish(poses(k * 1_000_000_000, 100), np.eye(4), np.eye(6), 2)
    assert time.monotonic() - started_s < 30.0  # the reader never reads
    assert metrics.dropped["feed_slow_reader"] > 1000
    call.cancel()
    channel.close()


def test_a_watcher_that_goes_frees_its_place(tmp_path: Path, feed: PoseFeed, metrics: EdgeMetrics):
    watcher = Watcher(tmp_path / "pose.sock")
    wait_for_readers(metrics, 1)
    watcher.call.cancel()
    wait_for_readers(metrics, 0)
    assert metrics.feed_readers.values()[()] == 0
    watcher.channel.close()


def test_a_socket_left_behind_by_a_killed_agent_is_taken_over(tmp_path: Path, metrics: EdgeMetrics):
    import socket

    path = tmp_path / "pose.sock"
    with socket.socket(socket.AF_UNIX) as dead:
        dead.bind(str(path))
    feed = PoseFeed(FeedConfig(), path, np.eye(4), metrics)
    feed.close()


def test_a_socket_that_cannot_be_made_is_one_line(tmp_path: Path, metrics: EdgeMetrics):
    with pytest.raises(InputError, match=r"^feed.socket .*nowhere"):
        PoseFeed(FeedConfig(), tmp_path / "nowhere" / "pose.sock", np.eye(4), metrics)
