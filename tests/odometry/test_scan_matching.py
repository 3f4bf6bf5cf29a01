"""The edge's scan matching: what it has not seen it does not say, and what has left the ring has left the map."""

from __future__ import annotations

import numpy as np
import pytest

from edge_agent.odometry.ring import Ring, even_shares
from edge_agent.odometry.scan_matching import Outcome, Placement, ScanMatching
from edge_agent.odometry.settings import OdometrySettings
from map_service.processes import resident_bytes
from splitslam import se3
from tests import tolerances as bars
from tests.odometry.made import NO_AXES, RNG, frame, pose

SETTINGS = OdometrySettings(keyframes=4)


def at(seq: int) -> Placement:
    return Placement(seq, seq * 100_000_000, pose(seq), np.eye(6) * 1e-6, NO_AXES, Outcome.PLACED)


def started(last: int, *scans, settings: OdometrySettings = SETTINGS) -> tuple[ScanMatching, Ring]:
    ring = Ring(settings.keyframes, 0, settings.keyframe_points)
    for made in scans:
        ring.add(made, pose(made.seq), np.eye(6) * 1e-6)
    matching = ScanMatching(settings, ring, redeskew=True, room=1 << 14)
    matching.start(at(last))
    return matching, ring


def corridor(count: int) -> np.ndarray:
    walls = np.column_stack([RNG.uniform(-40, 40, count), RNG.choice([-1.5, 1.5], count), RNG.uniform(0, 2.5, count)])
    floor = np.column_stack([RNG.uniform(-40, 40, count), RNG.uniform(-1.5, 1.5, count), np.zeros(count)])
    return np.concatenate([walls, floor])


def test_the_map_holds_what_the_ring_holds():
    matching, ring = started(5, *(frame(seq) for seq in range(1, 6)))
    for seq in range(6, 40):
        matching.place(frame(seq))
    kept = {keyframe.index for keyframe in ring.keyframes}
    assert len(kept) == SETTINGS.keyframes
    assert matching._local_map.keyframes == kept
    points = sum(len(keyframe.surfs_lidar) for keyframe in ring.keyframes)
    surfs = matching._local_map.surfs
    assert surfs.moments[:, 0].sum() == points * SETTINGS.local_map.surfs.levels


def test_a_ring_that_is_not_in_the_map_yet_may_overflow():
    settings = OdometrySettings(keyframes=8, first_keyframes=1, more_keyframes=1)
    matching, ring = started(8, *(frame(seq) for seq in range(1, 9)), settings=settings)
    for seq in range(9, 60):
        placed = matching.place(frame(seq))
        assert placed.outcome == Outcome.PLACED
    assert matching._local_map.keyframes == {keyframe.index for keyframe in ring.keyframes}


def test_along_a_corridor_the_prediction_is_left_alone_and_the_direction_named():
    none = np.zeros((0, 3))
    walls = corridor(20_000)
    matching, _ = started(5, *(frame(seq, walls, none, 4000) for seq in range(3, 6)))
    made = frame(6, walls, none, 1200)
    placed = matching.place(made)
    assert placed.outcome == Outcome.DEGENERATE
    (axis,) = placed.degenerate_axes
    along = pose(6)[:3, :3].T @ [1.0, 0.0, 0.0]
    assert abs(axis[3:] @ along) > 0.95
    off = pose(6)[:3, :3] @ (se3.inv(pose(6)) @ placed.T_steady_lidar)[:3, 3]
    predicted = pose(6)[:3, :3] @ (se3.inv(pose(6)) @ pose(5) @ made.motion.T_prev_lidar)[:3, 3]
    assert off[0] == pytest.approx(predicted[0], abs=0.003)
    assert abs(off[1]) < 0.01
    assert np.sqrt(along @ placed.covariance[3:, 3:] @ along) > 0.02


def test_shares_are_even_and_no_more_than_asked_for():
    made = frame(1)
    rows = even_shares((made.corners, made.surfs), 300)
    assert 298 <= sum(map(len, rows)) <= 300
    assert len(rows[1]) / len(made.surfs) == pytest.approx(len(rows[0]) / len(made.corners), rel=0.03)
    whole = even_shares((made.corners, made.surfs), 10_000)
    np.testing.assert_array_equal(whole[1], np.arange(len(made.surfs)))


def test_the_first_scan_takes_memory_for_what_is_in_the_map_and_not_for_what_there_is_room_for():
    settings = OdometrySettings()
    ring = Ring(settings.keyframes, 0, settings.keyframe_points)
    for seq in range(1, 31):
        ring.add(frame(seq, points=3000), pose(seq), np.eye(6) * 1e-6)
    throwaway = ScanMatching(settings, ring, redeskew=True, room=1 << 12)  # scratch arrays, kernels
    throwaway.start(at(30))
    throwaway.place(frame(31))
    grown, before = [], resident_bytes()
    matching = ScanMatching(settings, ring, redeskew=True)
    table = matching._local_map.surfs.slots.nbytes + matching._local_map.corners.slots.nbytes  # all of it is written to
    matching.start(at(30))
    for seq in range(31, 61):
        placed = matching.place(frame(seq))
        assert placed.outcome == Outcome.PLACED
        grown.append(resident_bytes() - before - table)
    room = matching._local_map.surfs.moments.nbytes + matching._local_map.surfs._geometry.nbytes
    assert room > 5 * bars.OUTAGE_MAP_BYTES
    assert grown[0] < bars.OUTAGE_MAP_BYTES
    assert grown[-1] < 2 * bars.OUTAGE_MAP_BYTES


def test_a_robot_that_sees_again_after_its_lidar_was_covered_holds_on_to_what_it_sees_then():
    nothing = np.tile([[300.0, 0.0, 0.0]], (20, 1))
    matching, _ = started(5, frame(5, surfs=nothing, corners=nothing))  # a map with nothing of the room in it
    outcomes, placed, carried = [], [], []
    for seq in range(6, 40):
        made = frame(seq)
        found = matching.place(made)
        outcomes.append(found.outcome)
        placed.append(found.T_steady_lidar)
        carried.append(made.motion.T_prev_lidar)
    first = outcomes.index(Outcome.PLACED)
    assert set(outcomes[:first]) == {Outcome.FAILED}
    assert set(outcomes[first:]) == {Outcome.PLACED}
    assert SETTINGS.failed_scans <= first < SETTINGS.failed_scans + 6  # every fifth scan is dense
    way = se3.inv(placed[first]) @ placed[-1]
    made_way = se3.inv(pose(6 + first)) @ pose(39)
    assert np.linalg.norm((se3.inv(made_way) @ way)[:3, 3]) < bars.EDGE_ODOMETRY_M
