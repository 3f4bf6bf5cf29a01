"""The codec on what real and independent recorders wrote."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from edge_agent.sources import open_recording
from splitslam import codec
from splitslam.robot import load_robot
from splitslam.scan import Scan, ScanPacket
from tests.features.made_scan import KnownMotion, make_pipeline
from tests.tolerances import CODEC_DENSE_VLP16_BITS


@pytest.mark.parametrize("name", ["yard1/yard1", "kitti_0005/kitti_0005_ring16", "kitti_0005/kitti_0005_ring64_4s"])
def test_recorded_scans_become_frames_of_the_promised_size(shared_data: Path, name: str):
    robot = load_robot(shared_data / f"{name}.yaml")
    recording = open_recording(shared_data / f"{name}.bag", robot, max_scans=3)
    pipeline = make_pipeline(KnownMotion(), recording.beam_elevations_rad, robot.lidar.columns)
    scans = [event for _, event in recording.events() if isinstance(event, Scan)]
    assert len(scans) == 3
    for scan in scans:
        frame = pipeline.process(ScanPacket(scan))
        decoded = codec.decode(frame.payload, frame.seq, frame.stamp_ns, frame.dense, recording.beam_elevations_rad)
        assert len(decoded.surfs) == frame.surfs > 2000
        assert decoded.surfs.t_offset_ns.min() >= -50_000
        assert decoded.surfs.t_offset_ns.max() <= scan.end_ns - scan.stamp_ns + 50_000
        range_m = np.linalg.norm(decoded.surfs.points_lidar, axis=1)
        assert robot.lidar.min_range_m - 0.5 < range_m.min() < range_m.max() < robot.lidar.max_range_m + 0.5
        if name.startswith("yard1"):
            assert 8 * len(frame.payload) / (frame.corners + frame.surfs) <= CODEC_DENSE_VLP16_BITS
    recording.close()
