"""The pose for programs on the robot: LocalPoseService on a Unix socket. A slow reader loses samples, nobody waits."""

from __future__ import annotations

import stat
import threading
from collections import deque
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import grpc
import numpy as np
from numpy.typing import NDArray

from edge_agent.config import FeedConfig
from edge_agent.metrics import EdgeMetrics
from edge_agent.rate_grid import RateGrid
from edge_agent.types import OdomPoses
from edge_agent.wire import transform
from splitslam import se3
from splitslam.errors import InputError
from splitslam.wire import local_pb2 as pb
from splitslam.wire import local_pb2_grpc as rpc

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class PoseSample:
    """T_odom_body and what belongs to it. velocity_mps: (3,), origin of `body`, frame `body`."""

    stamp_ns: int
    T_odom_body: Array
    T_map_odom: Array
    velocity_mps: Array
    covariance: Array
    state: int

    def message(self) -> pb.WatchResponse:
        vx, vy, vz = self.velocity_mps
        return pb.WatchResponse(
            stamp_ns=self.stamp_ns,
            pose_odom_body=transform(self.T_odom_body),
            pose_map_odom=transform(self.T_map_odom),
            vx_mps=vx,
            vy_mps=vy,
            vz_mps=vz,
            covariance=self.covariance.reshape(-1).tolist(),
            state=self.state,  # pyright: ignore[reportArgumentType]  # an open enum
        )


class _Reader:
    """One Watch call's bounded queue."""

    def __init__(self, limit: int, max_rate_hz: float) -> None:
        self._grid = RateGrid(max_rate_hz)
        self._samples: deque[PoseSample] = deque()
        self._limit = limit
        self._changed = threading.Condition()
        self._closed = False

    def offer(self, sample: PoseSample) -> bool:
        """Queues the sample if it is due; False when an older one had to go for it."""
        if not self._grid.due(sample.stamp_ns):
            return True
        with self._changed:
            self._samples.append(sample)
            lost = len(self._samples) > self._limit
            if lost:
                self._samples.popleft()
            self._changed.notify()
            return not lost

    def take(self) -> PoseSample | None:
        """Waits for the next sample; None after `close`."""
        with self._changed:
            self._changed.wait_for(lambda: self._samples or self._closed)
            return None if self._closed else self._samples.popleft()

    def close(self) -> None:
        with self._changed:
            self._closed = True
            self._changed.notify()


class PoseFeed(rpc.LocalPoseServiceServicer):
    """Serves Watch on `settings.socket`. Raises InputError when the socket cannot be opened."""

    def __init__(self, settings: FeedConfig, socket: Path, T_body_lidar: Array, metrics: EdgeMetrics) -> None:
        self._settings, self._metrics = settings, metrics
        self._T_lidar_body = se3.inv(T_body_lidar)
        self._readers: list[_Reader] = []
        self._lock = threading.Lock()
        self._previous: tuple[int, Array] | None = None
        self._server = grpc.server(
            ThreadPoolExecutor(settings.max_readers, "feed"), maximum_concurrent_rpcs=settings.max_readers
        )
        rpc.add_LocalPoseServiceServicer_to_server(self, self._server)
        try:
            if socket.exists() and stat.S_ISSOCK(socket.stat().st_mode):
                socket.unlink()  # left by an agent that was killed
            if not self._server.add_insecure_port(f"unix:{socket.absolute()}"):
                raise RuntimeError
        except (OSError, RuntimeError):
            raise InputError(f"feed.socket {socket}: expected a path where a Unix socket can be made") from None
        self._server.start()

    def publish(self, poses: OdomPoses, T_map_odom: Array, covariance: Array, state: int) -> None:
        """Hands IMU-rate poses to whoever watches; never blocks."""
        with self._lock:
            readers = list(self._readers)
        if not readers:
            self._previous = None
            return
        for stamp_ns, position_m, quat, velocity_mps in zip(
            poses.stamps_ns.tolist(), poses.positions_m, poses.quats_xyzw, poses.velocities_mps, strict=True
        ):
            T_odom_body = se3.from_quat(position_m, quat) @ self._T_lidar_body
            velocity = T_odom_body[:3, :3].T @ velocity_mps
            if self._previous is not None and stamp_ns > self._previous[0]:
                velocity = _body_velocity(self._previous, stamp_ns, T_odom_body)
            self._previous = (stamp_ns, T_odom_body)
            sample = PoseSample(stamp_ns, T_odom_body, T_map_odom, velocity, covariance, state)
            for reader in readers:
                if not reader.offer(sample):
                    self._metrics.drop("feed_slow_reader")

    def Watch(self, request: pb.WatchRequest, context: grpc.ServicerContext) -> Iterator[pb.WatchResponse]:
        """Streams samples from now on."""
        reader = _Reader(self._settings.queue_samples, request.max_rate_hz)
        if not context.add_callback(reader.close):
            return
        self._enter(reader)
        try:
            while (sample := reader.take()) is not None:
                yield sample.message()
        finally:
            self._leave(reader)

    def _enter(self, reader: _Reader) -> None:
        with self._lock:
            self._readers.append(reader)
            self._metrics.feed_readers.set(len(self._readers))

    def _leave(self, reader: _Reader) -> None:
        with self._lock:
            self._readers.remove(reader)
            self._metrics.feed_readers.set(len(self._readers))

    def close(self) -> None:
        """Ends every Watch and removes the socket."""
        for reader in list(self._readers):
            reader.close()
        self._server.stop(grace=0.2).wait()


def _body_velocity(previous: tuple[int, Array], stamp_ns: int, T_odom_body: Array) -> Array:
    """Mean velocity of the body's origin since the sample before, frame `body`: the lever arm is then in it."""
    before_ns, T_before = previous
    return T_odom_body[:3, :3].T @ (T_odom_body[:3, 3] - T_before[:3, 3]) * (1e9 / (stamp_ns - before_ns))
