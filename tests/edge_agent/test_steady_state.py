"""What a scan costs besides its kernels: nothing stays behind, nothing of its length is made, nothing is compiled."""

from __future__ import annotations

import json
import subprocess
import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import yaml

from edge_agent.imu import make_imu_node
from edge_agent.imu.settings import ImuSettings
from edge_agent.pipeline import EdgePipeline
from edge_agent.settings import PipelineSettings
from splitslam.robot import robot_from_yaml
from splitslam.scan import ImuSamples, Scan, ScanPacket
from tests import tolerances as bars
from tests.conftest import ROOT
from tests.edge_agent.fake_service import FakeService
from tests.features.made_scan import made_scan

SCAN_NS = 100_000_000
ROBOT = (
    "{lidar: {rings: 64, columns: 2048}, imu: {rate_hz: 200}, T_lidar_imu: [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}"
)


def standing(start_ns: int) -> ImuSamples:
    stamps_ns = start_ns + np.arange(5_000_000, SCAN_NS + 5_000_001, 5_000_000)
    return ImuSamples(stamps_ns, np.zeros((len(stamps_ns), 3)), np.tile([0.0, 0.0, 9.80665], (len(stamps_ns), 1)))


def memory_of_scans(rings: int, firings: int) -> tuple[int, list[int], list[int]]:
    """Points of a scan; of scans once all is warm: bytes that stay, and bytes that were there at most in between."""
    robot = robot_from_yaml(ROBOT)
    elevations_rad = np.radians(np.linspace(-15.0, 15.0, rings)).astype(np.float32)
    node = make_imu_node(robot, ImuSettings())
    pipeline = EdgePipeline(robot, PipelineSettings(deskew="cpu"), elevations_rad, node)
    made = made_scan(0, elevations_rad, firings)
    stays, most = [], []
    try:
        for k in range(24):
            start_ns = made.stamp_ns + k * SCAN_NS
            node.add_imu(standing(start_ns - SCAN_NS))
            node.add_imu(standing(start_ns))
            end_ns = start_ns + made.end_ns - made.stamp_ns
            scan = Scan(start_ns, end_ns, made.points_lidar, made.t_offset_ns, made.ring, made.intensity)
            if k == 12:
                tracemalloc.start()
            tracemalloc.reset_peak()
            before = tracemalloc.get_traced_memory()[0]
            frame = pipeline.process(ScanPacket(scan))
            assert k < 12 or not frame.dense
            del frame
            after, peak = tracemalloc.get_traced_memory()
            if k >= 14:
                stays.append(after - before)
                most.append(peak - before)
    finally:
        tracemalloc.stop()
    return len(made), stays, most


def test_a_scan_leaves_nothing_behind_and_no_array_of_its_length_is_made_for_it():
    few, few_stay, few_most = memory_of_scans(16, 900)
    many, many_stay, many_most = memory_of_scans(64, 1808)
    assert many > 6 * few
    for stays in (few_stay, many_stay):
        assert np.median(stays) < bars.STEADY_SCAN_STAYS_BYTES
    assert max(many_most) < bars.STEADY_SCAN_BYTES
    assert max(many_most) - min(few_most) < 0.5 * (many - few)  # half a byte a point: not even a mask


@pytest.fixture(scope="module")
def filled_cache() -> None:
    """The kernels are compiled, as after an installation."""
    subprocess.run([sys.executable, "-m", "edge_agent", "warm-up"], cwd=ROOT, check=True, capture_output=True)


def test_a_warm_start_is_quick_and_no_scan_waits_for_a_compiler(shared_data: Path, tmp_path: Path, filled_cache: None):
    with FakeService(pose_x_m=lambda seq: 0.0) as service:
        values = {
            "robot": str(shared_data / "yard1" / "yard1.yaml"),
            "server": service.address,
            "source": {"recording": str(shared_data / "yard1" / "yard1.bag"), "max_scans": 30},
            "output": {"dir": str(tmp_path / "out")},
            "state_dir": str(tmp_path / "state"),
            "metrics": {"port": None},
        }
        (tmp_path / "agent.yaml").write_text(yaml.safe_dump(values))
        command = [sys.executable, "-m", "tests.edge_agent.watched_agent", str(tmp_path / "agent.yaml")]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stderr[-2000:]
    report = json.loads(done.stdout.splitlines()[-1])
    assert report["warm"] > 50
    assert report["late"] == []  # neither compiled nor read from the cache
    code = "import time, numba; print(time.process_time())"
    numba_s = min(
        float(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout)
        for _ in range(2)
    )
    assert report["first_frame_cpu_s"] < bars.WARM_START_IMPORTS * numba_s
