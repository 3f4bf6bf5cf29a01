"""Times of points, told by a made room seen from a walk: given, mirrored, and of points that are deskewed already."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest

from splitslam.check import point_times
from splitslam.check.findings import Severity
from splitslam.check.motion import LidarMotion
from splitslam.check.point_times import PointTimeProbe, TimeShare
from splitslam.scan import Scan
from tests import tolerances
from tests.check import made

ROOM_M = np.array([[-9.0, -7.0, -1.5], [21.0, 8.0, 4.0]])  # low and high corner
COLUMNS, SCANS = 120, 50
ELEVATIONS = np.radians(np.arange(-15.0, 15.5, 2.0))
SPAN_NS = 100_000_000


@functools.cache
def scan_at(drive: made.Drive, middle_s: float, seed: int) -> tuple[Scan, np.ndarray]:
    """One turn, clockwise, noise of 1 cm, times as measured; and where each point is seen from the middle (N, 3)."""
    fraction, elevation = np.meshgrid(np.arange(COLUMNS) / COLUMNS, ELEVATIONS, indexing="ij")
    azimuth = np.pi - 2.0 * np.pi * fraction
    rays = np.stack(
        [np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)], axis=-1
    ).reshape(-1, 3)
    t_s = (fraction.ravel() - 0.5) * SPAN_NS * 1e-9 + middle_s
    R, origin = drive.attitude(t_s), drive.position(t_s)
    ahead = (R @ rays[:, :, None])[:, :, 0]
    with np.errstate(divide="ignore"):
        walls_m = np.maximum((ROOM_M[0] - origin) / ahead, (ROOM_M[1] - origin) / ahead)
    range_m = walls_m.min(axis=1) + 0.01 * np.random.default_rng(seed).normal(size=len(rays))
    R_middle, middle = drive.attitude(np.array([middle_s]))[0], drive.position(np.array([middle_s]))[0]
    from_middle = (origin + ahead * range_m[:, None] - middle) @ R_middle
    start_ns = made.START_NS + round(middle_s * 1e9) - SPAN_NS // 2
    offset_ns = np.rint(fraction.ravel() * SPAN_NS).astype(np.int32)
    ring = np.tile(np.arange(len(ELEVATIONS)), COLUMNS).astype(np.uint8)
    points = (rays * range_m[:, None]).astype(np.float32)
    return Scan(start_ns, start_ns + SPAN_NS, points, offset_ns, ring, np.zeros_like(ring)), from_middle


def as_recorded(scan: Scan, from_middle: np.ndarray, kind: str) -> Scan:
    match kind:
        case "mirrored":
            return replace(scan, t_offset_ns=SPAN_NS - scan.t_offset_ns)
        case "deskewed":
            return replace(scan, points_lidar=from_middle.astype(np.float32))
        case "one moment":
            return replace(scan, t_offset_ns=np.full_like(scan.t_offset_ns, SPAN_NS // 2 + 40_000_000))
    return scan


def looked_at(kind: str, drive: made.Drive = made.WALK) -> TimeShare | None:
    probe = PointTimeProbe()
    for k in range(SCANS):
        probe.add(as_recorded(*scan_at(drive, k * made.SCAN_S, k), kind))
    return probe.share(made.motion(drive, SCANS * made.SCAN_S))


@pytest.mark.parametrize(
    ("kind", "share", "expected"),
    [("as measured", 1.0, None), ("mirrored", -1.0, "mirrored"), ("deskewed", 0.0, "one_moment")],
)
def test_planes_are_thin_only_with_the_times_that_points_were_measured_at(
    kind: str, share: float, expected: str | None
) -> None:
    found = looked_at(kind)
    assert found is not None
    assert found.share == pytest.approx(share, abs=tolerances.CHECK_POINT_TIMES)
    assert found.sigma < tolerances.CHECK_POINT_TIMES
    assert [f.expected for f in point_times.findings(found)] == ([] if expected is None else [expected])
    assert all(f.severity is Severity.PROBLEM for f in point_times.findings(found))


@pytest.mark.parametrize(
    "drive",
    [
        made.Drive(wobble_rad=0.0, surge_m=0.0, speed_mps=0.0),
        made.Drive(wobble_rad=0.0, turn_rad=0.0, surge_m=6.0, speed_mps=0.0),
    ],
    ids=["turns", "way"],
)
def test_turns_alone_and_a_way_without_turns_tell_it_too(drive: made.Drive) -> None:
    found = looked_at("mirrored", drive)
    assert found is not None
    assert found.share == pytest.approx(-1.0, abs=tolerances.CHECK_POINT_TIMES)
    assert found.sigma < tolerances.CHECK_POINT_TIMES, "without it the share is a guess, and may be a good one"


def test_points_without_a_time_of_their_own_tell_nothing_and_are_no_problem() -> None:
    found = looked_at("one moment")
    assert found is not None
    assert found.sigma > 1.0
    assert point_times.findings(found) == []


def test_a_robot_that_stands_tells_nothing() -> None:
    assert looked_at("mirrored", made.STANDING) is None
    assert point_times.findings(None) == []


def test_a_share_between_is_a_note_and_an_unsure_one_is_not_mentioned() -> None:
    (between,) = point_times.findings(TimeShare(0.5, 0.05, 500, 40))
    assert between.severity is Severity.NOTE
    assert point_times.findings(TimeShare(-1.0, 0.3, 500, 40)) == []


def test_what_is_kept_of_a_long_recording_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(point_times, "_KEPT", 20)
    probe = PointTimeProbe()
    for k in range(30):
        probe.add(scan_at(made.WALK, k * made.SCAN_S, k)[0])
    motion = made.motion(made.WALK, 3.0)
    assert probe.share(LidarMotion(motion.stamps_ns[20:], motion.T_odom_lidar[20:])) is None
