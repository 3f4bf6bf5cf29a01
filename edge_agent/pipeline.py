"""One scan's way through the edge: the paper's Image node and Feature node, in its order (Fig. 3, Case 3)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from edge_agent.dense import DensePolicy
from edge_agent.deskew import make_deskewer
from edge_agent.features.curvature import SmoothnessFilter
from edge_agent.features.projection import Projector
from edge_agent.features.select import Selector
from edge_agent.settings import PipelineSettings
from edge_agent.stage_clock import StageClock
from edge_agent.types import EncodedFrame, MotionSource
from splitslam import codec
from splitslam.errors import DataError
from splitslam.features import FeatureFrame
from splitslam.robot import Robot
from splitslam.scan import ScanPacket


class EdgePipeline:
    """Image node and Feature node of one sensor. Synchronous, single-threaded, no network."""

    def __init__(
        self, robot: Robot, settings: PipelineSettings, beam_elevations_rad: NDArray[np.float32], imu: MotionSource
    ) -> None:
        """beam_elevations_rad: (rings,), what the ring numbers mean; InputError for a deskew that is not there."""
        rings, self.columns = len(beam_elevations_rad), robot.lidar.columns
        self.settings, self.beam_elevations_rad, self.imu = settings, beam_elevations_rad, imu
        self.deskewer = make_deskewer(settings.deskew)
        self.dense = DensePolicy(settings.dense)
        self.seq = 0
        self.dropped_points = {"duplicate": 0, "ring": 0}
        self._project = Projector(rings, self.columns).project
        self._smoothness = SmoothnessFilter(rings * self.columns)
        self._select = Selector(settings.features, rings, self.columns).select
        self._deskewed = np.empty((rings * self.columns, 3), np.float32)

    def process(self, packet: ScanPacket) -> EncodedFrame:
        """A scan to its encoded frame. DataError (`empty`, `few_points`) drops the scan; no seq is used up."""
        scan, clock = packet.scan, StageClock()

        # Image node. Projection comes first: a scan that is dropped must not count as the previous one of the Imu node.
        image = self._project(scan)  # Algorithm 1, lines 8-14, 16, 17
        self.dropped_points["duplicate"] += image.duplicates
        self.dropped_points["ring"] += image.outside
        if len(image) == 0:
            raise DataError("empty", "scan without points")
        if len(image) < self.settings.min_points:
            raise DataError("few_points", f"{len(image)} points, expected at least {self.settings.min_points}")
        clock.lap("deskew")
        motion = self.imu.motion_over(scan.stamp_ns, scan.end_ns)  # T_prev_lidar: the paper's T_ini; knots
        knots = codec.quantise_knots(self.deskewer.effective(motion.knots))
        clock.lap("motion")
        points = self._deskewed[: len(image)]
        self.deskewer.deskew(image.points_lidar, image.t_offset_ns, knots, points)  # line 15; equations 1 and 2
        clock.lap("deskew")

        # Feature node
        smooth = self._smoothness(image)
        dense = self.dense.decide(motion.T_prev_lidar)
        corners, surfs = self._select(image, points, smooth, dense)
        frame = FeatureFrame(self.seq + 1, scan.stamp_ns, dense, replace(motion, knots=knots), corners, surfs)
        clock.lap("features")

        # to the Map node
        payload = codec.encode(frame, self.beam_elevations_rad, self.columns, self.settings.step_m)
        self.seq += 1
        clock.lap("encode")
        clock.stop()
        return EncodedFrame(
            seq=self.seq,
            stamp_ns=scan.stamp_ns,
            dense=dense,
            payload=payload,
            fixes=packet.fixes,
            stage_cpu_ms=clock.cpu_ms,
            stage_wall_ms=clock.wall_ms,
            corners=len(corners),
            surfs=len(surfs),
        )
