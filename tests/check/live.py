"""A run of both pipelines in this process, in lockstep as the agent's, with the live check looking on."""

from __future__ import annotations

from pathlib import Path

from edge_agent.check import LiveCheck
from edge_agent.imu import ImuSettings, make_imu_node
from edge_agent.metrics import EdgeMetrics
from edge_agent.pipeline import EdgePipeline
from edge_agent.settings import PipelineSettings
from edge_agent.sources import Sequencer, open_recording
from edge_agent.types import OdometryReply
from edge_agent.wire import Answer
from map_service.pipeline import MapPipeline
from map_service.settings import PipelineSettings as MapSettings
from splitslam import codec
from splitslam.check.odometry import NoLoops
from splitslam.robot import Robot
from splitslam.scan import ImuSamples, WheelSamples

LAG = 2


def run_live(path: Path, robot: Robot, scans: int) -> tuple[LiveCheck, EdgeMetrics]:
    """The check after the run; scan k sees the answers to scans <= k - 2."""
    with open_recording(path, robot, max_scans=scans) as recording:
        robot = recording.robot
        metrics = EdgeMetrics()
        check, sequencer = LiveCheck(robot, metrics), Sequencer(robot)
        node = make_imu_node(robot, ImuSettings())
        edge = EdgePipeline(robot, PipelineSettings(), recording.beam_elevations_rad, node)
        service = MapPipeline(robot, MapSettings(), NoLoops(), frozenset({"loops", "gnss"}))
        replies: list[OdometryReply] = []
        for _, event in recording.events():
            check.on_event(event)
            for item in sequencer.push(event):
                if isinstance(item, ImuSamples):
                    node.add_imu(item)
                    continue
                if isinstance(item, WheelSamples):
                    continue
                if len(replies) >= LAG:
                    reply = replies[-LAG]
                    node.on_odometry(reply)
                    check.on_answer(Answer(reply, False, None, 0.0))
                sent = edge.process(item)
                frame = codec.decode(sent.payload, sent.seq, sent.stamp_ns, sent.dense, recording.beam_elevations_rad)
                a = service.process(frame, item.fixes)
                replies.append(
                    OdometryReply(
                        a.seq,
                        a.stamp_ns,
                        a.T_map_lidar,
                        a.T_map_odom,
                        a.covariance,
                        int(a.state),
                        a.degenerate_axes,
                    )
                )
    check.finish()
    return check, metrics
