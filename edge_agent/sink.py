"""Where the loop's results go: files, the local feed, the run's tally, progress lines, what outlives the agent."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge_agent.clouds.keeper import CloudKeeper
from edge_agent.feed import PoseFeed
from edge_agent.loop import Imu
from edge_agent.odometry.outage import Correction
from edge_agent.outputs import Outputs
from edge_agent.ros.output import RosOutput
from edge_agent.tally import Tally
from edge_agent.types import EncodedFrame, OdomPoses
from edge_agent.wire import Answer, frame_message
from splitslam.codec import CODEC_VERSION
from splitslam.wire import session_pb2 as pb

_PROGRESS_EVERY_S = 0.1


class Progress:
    """JSON lines on stdout for whoever started the agent, at most ten scan lines a second."""

    def __init__(self, on: bool) -> None:
        self._on = on
        self._last_s = float("-inf")

    def start(self, scans: int | None) -> None:
        self._line(event="start", scans=scans)

    def scan(self, read: int, mapped: int) -> None:
        now_s = time.monotonic()
        if now_s - self._last_s >= _PROGRESS_EVERY_S:
            self._last_s = now_s
            self._line(event="scan", read=read, mapped=mapped)

    def dense(self, sent: int, waiting: int) -> None:
        """After the last scan: dense clouds that are sent, and those that are not yet."""
        self._line(event="dense", sent=sent, waiting=waiting)

    def end(self, read: int, mapped: int) -> None:
        self._line(event="scan", read=read, mapped=mapped)
        self._line(event="end")

    def _line(self, **fields: Any) -> None:
        if self._on:
            print(json.dumps(fields), file=sys.stdout, flush=True)


@dataclass(slots=True)
class AgentSink:
    """Implements edge_agent.loop.Sink; outputs, feed and ros may be switched off (None).

    by_scan: there are no IMU-rate poses: ROS gets those of the scans. clouds: None: no whole scans are kept.
    """

    tally: Tally
    outputs: Outputs | None
    feed: PoseFeed | None
    ros: RosOutput | None
    by_scan: bool
    progress: Progress
    run_id: str
    reader_cpu_s: Callable[[], float]
    keep_run: Callable[[], None]
    report_drops: Callable[[], None]
    clouds: CloudKeeper | None = None
    read: int = 0

    def on_scan_begun(self) -> None:
        """A scan goes into the pipeline."""
        self.read += 1
        self.tally.begin(self.reader_cpu_s())

    def on_frame(self, frame: EncodedFrame, T_odom_lidar: NDArray[np.float64]) -> pb.Frame:
        """A frame is ready; returns it as it goes on the wire. T_odom_lidar: (4, 4), at its stamp."""
        self.tally.frame(frame)
        if self.outputs is not None:
            self.outputs.odom(frame.stamp_ns, T_odom_lidar)
        if self.ros is not None and self.by_scan:
            self.ros.publish(OdomPoses.of(frame.stamp_ns, T_odom_lidar))
        self.keep_run()
        self.report_drops()
        if self.clouds is not None and frame.scan is not None:
            self.clouds.keep(frame.scan)
        elif self.clouds is not None and frame.dense:
            self.clouds.lose(frame.seq, frame.stamp_ns, "motion")
        return frame_message(frame, CODEC_VERSION)

    def on_answer(self, answer: Answer) -> None:
        """The Imu node has the answer."""
        self.tally.answer(answer)
        reply = answer.reply
        if self.clouds is not None:
            self.clouds.answered(reply.seq, answer.keyframe)
        if self.outputs is not None and not reply.rejected:
            self.outputs.online(reply)
        self.progress.scan(self.read, self.tally.mapped)

    def on_correction(self, correction: Correction) -> None:
        """`map` moved under the robot, as the map service is back; cause `outage`."""
        self.tally.correction("outage", correction.translation_m)

    def on_poses(self, poses: OdomPoses, imu: Imu, state: int) -> None:
        """New IMU-rate poses."""
        if self.outputs is not None:
            self.outputs.imu(poses, imu.T_map_odom)
        if self.feed is not None:
            self.feed.publish(poses, imu.T_map_odom, imu.covariance, state)
        if self.ros is not None:
            self.ros.publish(poses)
