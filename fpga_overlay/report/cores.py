"""What the cores do, on Verilator: clocks, error, and answers that are not the golden model's."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from edge_agent.deskew.reference import deskew_float64
from edge_agent.features.integer import Limits
from edge_agent.settings import FeatureSettings
from fpga_overlay.cosim.verilated import VerilatedTop
from fpga_overlay.driver.request import ROOM_BEATS, Request, RequestWriter
from fpga_overlay.golden import features, fixed, packet
from fpga_overlay.golden.packet import Beats
from fpga_overlay.report import workload
from splitslam.features import Knots
from splitslam.scan import Scan

RINGS, COLUMNS = packet.MAX_RINGS, packet.MAX_COLUMNS  # as synthesised for the board
IMAGES = [(16, 1800), (64, 1024), (128, 200), (5, 64)]  # random ones; the last two have short rings


def request(scan: Scan, knots: Knots, rings: int, columns: int, flags: int = 0) -> Request:
    """The packet that the driver sends for a scan."""
    writer = RequestWriter(rings, columns, Limits.of(FeatureSettings()), flags)
    return writer.write(scan, knots, 1, np.empty((ROOM_BEATS + len(scan), 4), np.uint32))


def full_request(rings: int, columns: int, flags: int = 0) -> Request:
    """The packet for a scan with a point in every cell and 500 IMU samples a second."""
    return request(workload.full_scan(rings, columns), workload.turning(), rings, columns, flags)


def deskew_core() -> VerilatedTop:
    """Deskew, range and column alone."""
    return VerilatedTop(top="deskew_core")


def both_cores() -> VerilatedTop:
    """The chain as it is built for the board."""
    return VerilatedTop(RINGS, COLUMNS)


def cycles(core: VerilatedTop, asked: Request) -> int:
    """Clocks from the packet's first beat to the answer's last, without pauses on either side.

    Of the second of two: after reset the first one waits until the image is cleared.
    """
    core.run(asked.beats)
    return core.run(asked.beats)[1]


def max_error_mm(core: VerilatedTop, range_m: float = 100.0, count: int = 8000) -> float:
    """The worst deskewed point against float64, turning at the paper's 217 degrees a second; IMU at 100 to 500 Hz."""
    worst = 0.0
    for imu_hz in (100, 250, 500):
        for phase in (0.3, np.pi / 2):  # turning faster, turning fastest
            scan, knots = workload.far_points(count, range_m), workload.turning(imu_hz, phase)
            answer, _ = core.run(request(scan, knots, 16, 1800).beats)
            exact = deskew_float64(scan.points_lidar.astype(np.float64), scan.t_offset_ns, knots)
            worst = max(worst, float(np.linalg.norm(_points(answer, count) - exact, axis=1).max()))
    return worst * 1e3


def mismatches(core: VerilatedTop, scans: Iterable[tuple[Scan, int, int]]) -> int:
    """Beats of the core's answers that are not the golden model's, of scans with their rings and columns."""
    knots = workload.turning()
    wrong = 0
    for scan, rings, columns in scans:
        asked = request(scan, knots, rings, columns)
        wrong += differing(core.run(asked.beats)[0], features.answer(asked.header, asked.table.words, asked.points))
    return wrong


def differing(answer: Beats, expected: Beats) -> int:
    """Beats that differ; those that one answer has and the other has not are among them."""
    both = min(len(answer), len(expected))
    return int(np.any(answer[:both] != expected[:both], axis=1).sum()) + abs(len(answer) - len(expected))


def compared_scans() -> Iterable[tuple[Scan, int, int]]:
    """20 scans of yard1 and 8 random images."""
    yield from ((scan, 16, 1800) for scan in workload.yard1(20))
    for seed in range(2):
        yield from ((workload.random_image(*shape, seed), *shape) for shape in IMAGES)


def _points(answer: Beats, count: int) -> NDArray[np.float64]:
    words = answer[packet.HEADER_BEATS : packet.HEADER_BEATS + count, :3].view(np.int32)
    return (words >> 8) * 2.0**-fixed.POINT_FRACTION
