"""One scan's way through the edge: the paper's Image node and Feature node, in its order (Fig. 3, Case 3)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from edge_agent.bare import CarriedMotion, ends
from edge_agent.dense import DensePolicy
from edge_agent.features._projection_kernels import known_points
from edge_agent.features.projection import Image
from edge_agent.features.select import Selector
from edge_agent.image_node import make_image_node
from edge_agent.rate import RateControl
from edge_agent.settings import PipelineSettings
from edge_agent.stage_clock import StageClock
from edge_agent.types import EncodedFrame, MotionSource
from splitslam import codec
from splitslam.dense_cloud import WholeScan
from splitslam.errors import DataError
from splitslam.features import FeatureFrame, FeatureSet, Knots, Motion
from splitslam.robot import Robot
from splitslam.scan import Scan, ScanPacket

NO_IMU_SIGMA_RAD = 0.4  # an Imu node that has no samples says it does not know where down is


class EdgePipeline:
    """Image node and Feature node of one sensor. Synchronous, single-threaded, no network."""

    def __init__(
        self, robot: Robot, settings: PipelineSettings, beam_elevations_rad: NDArray[np.float32], imu: MotionSource
    ) -> None:
        """beam_elevations_rad: (rings,), what the ring numbers mean; InputError for a deskew that is not there."""
        rings, self.columns = len(beam_elevations_rad), robot.lidar.columns
        self.settings, self.beam_elevations_rad, self.imu = settings, beam_elevations_rad, imu
        self.image_node = make_image_node(settings, rings, self.columns)
        self.dense = DensePolicy(settings.dense)
        self.seq = 0
        self.dropped_points = {"duplicate": 0, "ring": 0}
        self.keeps_scans = False  # is a dense frame to come with its whole scan?
        self.rate = RateControl(settings.rate)
        self._carried = CarriedMotion(settings.carried)
        self._selector = Selector(settings.features, rings, self.columns)
        self._rings = rings

    def process(self, packet: ScanPacket) -> EncodedFrame:
        """A scan to its encoded frame. DataError (`empty`, `few_points`, `budget`, `motion`) drops it; no seq used."""
        scan, clock = packet.scan, StageClock()

        # Image node. A scan that is dropped must not count as the previous one of the Imu node: so that comes first.
        self._check(scan)
        motion = self.imu.motion_over(scan.stamp_ns, scan.end_ns)  # T_prev_lidar: the paper's T_ini; knots
        knots = self._knots(motion)
        clock.lap("motion")
        image = self.image_node.image(scan, knots)
        self.dropped_points["duplicate"] += image.duplicates
        self.dropped_points["ring"] += image.outside
        clock.lap("deskew")

        # Feature node
        marks = self.image_node.marks(image)
        dense = self.dense.decide(motion.T_prev_lidar)
        blind = motion.gravity_sigma_rad >= NO_IMU_SIGMA_RAD
        times = self.settings.features.without_imu if blind else 1.0
        wanted = self._selector.find(image, marks, dense, times)
        known = self._carried.may_grow(motion, blind)
        allowed = self.rate.points(scan.stamp_ns, dense, wanted, known)
        if dense and not allowed:
            dense, self.dense.wanted = False, True  # put off
            wanted = self._selector.find(image, marks, dense, times)
            allowed = 0 if known else self.rate.points(scan.stamp_ns, dense, wanted)
        clock.lap("features")

        # to the Map node
        while True:
            corners, surfs = self._selector.choose(image, marks, dense, allowed / max(wanted, 1))
            sent = knots if allowed else ends(knots)
            frame = FeatureFrame(self.seq + 1, scan.stamp_ns, dense, replace(motion, knots=sent), corners, surfs)
            clock.lap("features")
            payload = self._encoded(frame)
            clock.lap("encode")
            if self.rate.fits(scan.stamp_ns, len(payload)) or allowed <= self.rate.settings.fewest_points:
                break
            allowed = int(0.8 * allowed)
        self.rate.sent(scan.stamp_ns, dense, len(corners) + len(surfs), wanted, len(payload))
        self._carried.went(motion, bare=allowed == 0)
        self.seq += 1
        own = frame
        if len(corners) + len(surfs) < wanted:  # the budget is the uplink's: on the robot all of them are there
            corners, surfs = self._selector.choose(image, marks, dense)
            own = replace(frame, corners=corners, surfs=surfs)
            clock.lap("features")
        clock.stop()
        scan_kept = self._whole(frame, image) if self.keeps_scans and dense and motion.velocity_known else None
        return EncodedFrame(
            seq=self.seq,
            stamp_ns=scan.stamp_ns,
            dense=dense,
            payload=payload,
            fixes=packet.fixes,
            stage_cpu_ms=clock.cpu_ms,
            stage_wall_ms=clock.wall_ms,
            corners=len(frame.corners),
            surfs=len(frame.surfs),
            features=own,
            scan=scan_kept,
        )

    def _whole(self, frame: FeatureFrame, image: Image) -> WholeScan:
        """A copy of the image, which the next scan overwrites."""
        points = FeatureSet(
            image.points_lidar.copy(),
            image.ring,
            image.column.copy(),
            image.scan.t_offset_ns[image.source],
            image.scan.intensity[image.source],
        )
        return WholeScan(frame.seq, frame.stamp_ns, frame.motion, points, self.beam_elevations_rad, self.columns)

    def _knots(self, motion: Motion) -> Knots:
        """The motion that is removed, as it travels. One that is beyond all bounds costs the scan, not the agent."""
        try:
            return codec.quantise_knots(self.image_node.effective(motion.knots))
        except ValueError as error:
            raise DataError("motion", str(error)) from None

    def _encoded(self, frame: FeatureFrame) -> bytes:
        """The same for the way since the scan before, and whatever else cannot be told."""
        try:
            return codec.encode(frame, self.beam_elevations_rad, self.columns, self.settings.step_m)
        except ValueError as error:
            raise DataError("motion", str(error)) from None

    def _check(self, scan: Scan) -> None:
        usable = known_points(scan.ring, self._rings)
        if usable == 0:
            raise DataError("empty", "scan without points")
        if usable < self.settings.min_points:
            raise DataError("few_points", f"{usable} points, expected at least {self.settings.min_points}")
        if not self.rate.admits(scan.stamp_ns):
            raise DataError("budget", "no room for a frame within the uplink's budget")
