"""What the agent publishes to ROS, as REP-105 has it, in a thread of its own that cannot hold up the pipeline."""

from __future__ import annotations

import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from edge_agent.ros import messages
from edge_agent.ros.base_samples import BaseSample, BaseSampler, Belief
from edge_agent.ros.codec import TF
from edge_agent.ros.connect import join
from edge_agent.ros.graph import STATIC, TRANSFORMS
from edge_agent.ros.outlets import Outlets, note_not_sent
from edge_agent.ros.owner import OdomOwner
from edge_agent.ros.settings import RosSettings
from edge_agent.ros.source import RosSource
from edge_agent.sources.source import Source
from edge_agent.types import OdomPoses
from edge_agent.wire import state_name
from splitslam import se3
from splitslam.robot import Robot

if TYPE_CHECKING:
    from edge_agent.config import AgentConfig

Array = NDArray[np.float64]
Report = Callable[[], Mapping[str, object]]
_KEPT_SAMPLES = 500  # of ours, until the other odometry has come as far
_LEVELS = {"tracking": messages.OK, "lost": messages.ERROR}  # all others: WARN


def open_output(
    config: AgentConfig, source: Source, belief: Belief, report: Report, stop: threading.Event, cleanup: ExitStack
) -> RosOutput | None:
    """In the source's graph, or in the one that `ros` names; None without either. Raises InputError as `join` does.

    report: what /diagnostics says besides the state. cleanup: gets what closes the output.
    """
    settings = config.ros
    node = config.source.ros or settings.ros1 or settings.ros2
    if not settings.publish or node is None:
        return None
    outlets = source.outlets if isinstance(source, RosSource) else None
    if outlets is None:
        graph = join(node, stop)
        cleanup.callback(graph.close)
        outlets = Outlets(graph, node, settings, source.robot.robot.id)
    output = RosOutput(settings, outlets, source.robot, belief, report)
    cleanup.callback(output.close)
    return output


class RosOutput:
    """Transforms, odometry and diagnostics. dropped: samples that the queue had no room for, or that were not sent."""

    def __init__(self, settings: RosSettings, outlets: Outlets, robot: Robot, belief: Belief, report: Report) -> None:
        self._settings, self._outlets, self._codec, self._report = settings, outlets, outlets.graph.codec, report
        self._sampler = BaseSampler(robot, belief, settings.rate_hz)
        self.dropped: Counter[str] = Counter()
        self.sent = 0
        self._state: int | None = None
        self._queue: deque[BaseSample] = deque()
        self._ahead: deque[BaseSample] = deque(maxlen=_KEPT_SAMPLES)  # of another node's odometry
        self._changed = threading.Condition()
        self._closed = False
        self._owner = OdomOwner(settings, self._codec)
        outlets.graph.subscribe(outlets.tf, TF, TRANSFORMS, self._owner.on_tf)
        outlets.graph.subscribe(f"{outlets.tf}_static", TF, STATIC, self._owner.on_static)
        self._thread = threading.Thread(target=self._run, name="ros-output", daemon=True)
        self._thread.start()

    def publish(self, poses: OdomPoses) -> None:
        """Takes poses of the LiDAR from the pipeline's thread; never waits."""
        for sample in self._sampler.take(poses):
            with self._changed:
                self._queue.append(sample)
                if len(self._queue) > self._settings.queue:
                    self._queue.popleft()
                    self.dropped["ros_queue_full"] += 1
                self._changed.notify()

    def close(self) -> None:
        """Says that the agent stops, and ends the thread; the graph stays open. Twice is no error."""
        with self._changed:
            self._closed = True
            self._changed.notify()
        self._thread.join()

    # --- the thread ---------------------------------------------------------------------------------------------

    def _run(self) -> None:
        period_s = 1.0 / self._settings.diagnostics_hz
        next_s = time.monotonic()
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._queue or self._closed, max(next_s - time.monotonic(), 0.0))
                closed, samples = self._closed, list(self._queue)
                self._queue.clear()
            for sample in samples:
                self._try(self._send, sample)
            if closed:
                self._try(self._send_status, "stopped", messages.WARN)
                return
            if time.monotonic() >= next_s:
                next_s = max(next_s + period_s, time.monotonic())
                self._try(self._send_status, *self._status())

    def _try(self, send: Callable[..., None], *arguments: object) -> None:
        try:
            send(*arguments)
        except Exception as error:
            note_not_sent(error, self.dropped)

    def _send(self, sample: BaseSample) -> None:
        self._state = sample.state
        frames = self._settings.odom_frame, self._settings.base_frame
        if self._owner.is_us:
            self._ahead.clear()
            self._owner.sent(sample.stamp_ns)
            self._send_transforms(sample.stamp_ns, sample.T_map_odom, [(*frames, sample.T_odom_base)])
            self._send_pose(sample, frames, sample.T_odom_base)
        else:
            self._ahead.append(sample)
            self._send_through_other()
            self._send_pose(sample, (self._settings.map_frame, frames[1]), sample.T_map_odom @ sample.T_odom_base)

    def _send_transforms(self, stamp_ns: int, T_map_odom: Array, more: list[tuple[str, str, Array]]) -> None:
        edges = [(self._settings.map_frame, self._settings.odom_frame, T_map_odom), *more]
        self._outlets.send_tf(self._codec.encode(messages.transforms(self._codec, stamp_ns, edges)))
        self.sent += 1

    def _send_pose(self, sample: BaseSample, frames: tuple[str, str], T: Array) -> None:
        doubts = sample.covariance, sample.twist, sample.doubt
        self._outlets.send_odometry(
            self._codec.encode(messages.odometry(self._codec, sample.stamp_ns, frames, T, *doubts))
        )

    def _send_through_other(self) -> None:
        """`map -> odom` such that the other node's `odom -> base` ends where we say, at the newest time both know."""
        settings, tree = self._settings, self._owner.tree
        newest_ns = tree.newest_ns(settings.base_frame)
        both: BaseSample | None = None
        while newest_ns is not None and self._ahead and self._ahead[0].stamp_ns <= newest_ns:
            both = self._ahead.popleft()
        if both is None:
            return
        T_odom_base = tree.lookup(settings.odom_frame, settings.base_frame, both.stamp_ns)
        if T_odom_base is None:
            self.dropped["ros_no_odom"] += 1
            return
        self._send_transforms(both.stamp_ns, both.T_map_odom @ both.T_odom_base @ se3.inv(T_odom_base), [])

    def _status(self) -> tuple[str, int]:
        """What /diagnostics says, and how bad it is."""
        settings = self._settings
        if settings.publish_odom_tf and self._owner.is_another:
            return f"another node places {settings.base_frame}: only map -> odom is published", messages.ERROR
        if not settings.publish_odom_tf and self._owner.tree.newest_ns(settings.base_frame) is None:
            return f"nobody publishes {settings.odom_frame} -> {settings.base_frame}", messages.ERROR
        if self._state is None:
            return "no pose yet", messages.WARN
        name = state_name(self._state)
        return name, _LEVELS.get(name, messages.WARN)

    def _send_status(self, text: str, level: int) -> None:
        self._outlets.say(text, level, {**self._report(), "transforms": self.sent, **self.dropped})
