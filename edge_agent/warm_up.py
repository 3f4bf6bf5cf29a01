"""One made-up drive of half a second through throw-away nodes, so that the first real scan finds compiled kernels.

Without it a cold compile cache costs seconds, and a run by the clock would begin with dropped scans.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from edge_agent._text_kernels import LONGEST_LINE, moved_lines
from edge_agent.imu import make_imu_node
from edge_agent.imu.settings import ImuSettings
from edge_agent.odometry.ring import Ring
from edge_agent.odometry.scan_matching import Outcome, Placement, ScanMatching
from edge_agent.odometry.settings import OdometrySettings
from edge_agent.pipeline import EdgePipeline
from edge_agent.settings import PipelineSettings
from edge_agent.sources.sequencer import Sequencer
from edge_agent.types import OdometryReply, OdomPoses
from splitslam import codec
from splitslam.features import FeatureFrame
from splitslam.robot import Robot
from splitslam.scan import ImuSamples, Scan, ScanPacket, WheelSamples

_SCANS = 4
_SCAN_NS = 100_000_000
_IMU_NS = 5_000_000, 2_000_000  # of even and odd scans: a fast IMU's motion is resampled


def warm_up(
    robot: Robot,
    pipeline: PipelineSettings,
    imu: ImuSettings,
    beam_elevations_rad: NDArray[np.float32],
    odometry: OdometrySettings | None = None,
) -> None:
    """Runs every kernel of the edge once with the types of a real run; leaves no trace.

    An overlay has been warmed up by its self-test and is not opened twice; its spare, the `cpu` back end, is run here.
    """
    node = make_imu_node(robot, imu)
    if pipeline.deskew in ("auto", "fpga", "cosim"):
        pipeline = pipeline.model_copy(update={"deskew": "cpu"})
    edge, sequencer = EdgePipeline(robot, pipeline, beam_elevations_rad, node), Sequencer(robot)
    for k in range(_SCANS):
        scan = _room(k * _SCAN_NS, robot, beam_elevations_rad)
        sequencer.push(scan)
        if robot.imu is not None:
            samples = _still(k * _SCAN_NS, _IMU_NS[k % 2], robot)
            sequencer.push_imu(samples, samples.stamps_ns.tolist())
            _as_text(node.add_imu(samples))
        if robot.wheels is not None:
            node.add_wheels(WheelSamples(np.array([k * _SCAN_NS + _IMU_NS[0]]), np.zeros((1, 2)), np.zeros(1)))
        frame = edge.process(ScanPacket(scan))
        codec.recode(frame.payload, 1, beam_elevations_rad, robot.lidar.columns)  # for a service of before
        pose = node.T_odom_lidar_at(frame.stamp_ns)
        reply = OdometryReply(frame.seq, frame.stamp_ns, pose, np.eye(4), np.eye(6) * 1e-4, 2, np.zeros((0, 6)))
        node.on_odometry(reply)
        if odometry is not None and frame.features is not None:
            _match(odometry, frame.features, reply)


def _as_text(poses: OdomPoses) -> None:
    text = np.empty(LONGEST_LINE * len(poses.stamps_ns), np.uint8)
    moved_lines(poses.stamps_ns, poses.positions_m, poses.quats_xyzw, np.eye(4), text)


def _match(settings: OdometrySettings, frame: FeatureFrame, reply: OdometryReply) -> None:
    """The scan against itself, out of a ring that it overflows."""
    ring = Ring(2, 0, settings.keyframe_points)
    for _ in range(2):
        ring.add(frame, reply.T_map_lidar, reply.covariance)
    matching = ScanMatching(settings, ring, redeskew=True, room=1)
    at = Placement(frame.seq, 0, reply.T_map_lidar, reply.covariance, reply.degenerate_axes, Outcome.PLACED)
    matching.start(at)
    matching.place(replace(frame, dense=True, stamp_ns=frame.stamp_ns + 1))
    matching.stop()


def _still(start_ns: int, step_ns: int, robot: Robot) -> ImuSamples:
    stamps_ns = start_ns + np.arange(0 if start_ns == 0 else step_ns, _SCAN_NS + 1, step_ns, dtype=np.int64)
    up_imu = robot.T_lidar_imu[:3, :3].T @ np.array([0.0, 0.0, robot.gravity_mps2])
    return ImuSamples(stamps_ns, np.zeros((len(stamps_ns), 3)), np.tile(up_imu, (len(stamps_ns), 1)))


def _room(stamp_ns: int, robot: Robot, beam_elevations_rad: NDArray[np.float32]) -> Scan:
    """A square room, seen once round: walls are surfs, its corners corners."""
    rings, columns = len(beam_elevations_rad), robot.lidar.columns
    azimuth = np.repeat(-2 * np.pi * np.arange(columns) / columns, rings)
    elevation = np.tile(beam_elevations_rad.astype(np.float64), columns)
    half_m = 0.5 * (robot.lidar.min_range_m + min(robot.lidar.max_range_m, 20.0))
    flat_m = half_m / np.maximum(np.abs(np.cos(azimuth)), np.abs(np.sin(azimuth)))
    points = np.stack([flat_m * np.cos(azimuth), flat_m * np.sin(azimuth), flat_m * np.tan(elevation)], axis=1)
    t_offset_ns = np.repeat(np.arange(columns) * (_SCAN_NS - 1) // columns, rings).astype(np.int32)
    return Scan(
        stamp_ns=stamp_ns,
        end_ns=stamp_ns + int(t_offset_ns[-1]),
        points_lidar=np.ascontiguousarray(points, np.float32),
        t_offset_ns=t_offset_ns,
        ring=np.tile(np.arange(rings, dtype=np.uint8), columns),
        intensity=np.full(rings * columns, 50, np.uint8),
    )
