"""Rounds on the same ground: GNSS that comes there, a lorry that parks there, and a map that is made anew meanwhile."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.town import FRAME_NS, Counts, Robot, Town, round_and_round
from map_service.growing import Poses
from map_service.pipeline import MapPipeline
from map_service.settings import GraphSettings, LoopSettings, PipelineSettings
from splitslam import se3
from splitslam.registration import _kernels as kernels
from splitslam.robot import Gnss
from splitslam.robot import Robot as RobotFile
from splitslam.scan import GnssFix
from splitslam.sim.gnss import enu_to_wgs84
from tests import tolerances as bars
from tests.map_pipeline.made_walks import Inline
from tests.map_pipeline.test_mapped_ground import filled_anew, voxels

LAP_M, SPEED_MPS = 50.0, 1.5
LAP = round(LAP_M / SPEED_MPS * 1e9 / FRAME_NS)  # scans
DATUM = (35.5, 139.6, 30.0)
T_ENU_WORLD = se3.exp(np.array([0.0, 0.0, 2.2, 120.0, -40.0, 3.0]))
LEVER_M = (0.1, 0.0, 0.3)
GNSS_SIGMA_M = 0.05
LORRY_AT_M, LORRY_M = (0.0, -11.8), (12.0, 3.0)  # centre and size; beside the way, on its outer side
TENT_AT_M, TENT_M = (0.0, 0.0), (8.0, 8.0)  # in the middle


class LorryTown(Town):
    """A town where a lorry may park, and a tent be put up."""

    def __init__(self, town: Town) -> None:
        super().__init__(town._clear)
        self.parked = False

    def around(self, position_m: np.ndarray) -> np.ndarray:
        walls = super().around(position_m)
        if not self.parked:
            return walls
        for centre_m, size_m in ((LORRY_AT_M, LORRY_M), (TENT_AT_M, TENT_M)):
            corners = centre_m + 0.5 * np.array(size_m) * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
            walls = np.vstack([walls, np.hstack([corners, np.roll(corners, -1, axis=0) - corners])])
        return walls


class Rounds:
    """A robot on its rounds, and the pipeline that maps them."""

    def __init__(self, gnss: bool = False, settings: PipelineSettings | None = None) -> None:
        town, self.way = round_and_round(LAP_M, SPEED_MPS)
        self.town = LorryTown(town)
        self.robot = Robot(self.town, self.way, counts=Counts((100, 500), (200, 1800)))
        antenna = Gnss(t_lidar_antenna_m=LEVER_M) if gnss else None
        robot_file = RobotFile(imu=None, gnss=antenna)
        settings = settings or PipelineSettings(loops=LoopSettings(apply_after_frames=5))
        self.pipeline = MapPipeline(robot_file, settings, Inline(), deskew="off")
        self.seq, self.off_m = 0, 0.0
        self._rng = np.random.default_rng(7)
        self.first_enu_m: np.ndarray | None = None  # of the fixes: near the origin of the map's datum

    def drive(self, scans: int, fixes: bool = False) -> None:
        """So many more; off_m: the largest distance of an answer from the truth on them."""
        self.off_m = 0.0
        T_world_first = self.way(FRAME_NS * 1e-9)
        for _ in range(scans):
            self.seq += 1
            given = [self._fix()] if fixes and self.seq % 2 == 0 else []
            answer = self.pipeline.process(self.robot.frame(self.seq), given)
            expected_m = T_world_first[:3, :3].T @ (self._world()[:3, 3] - T_world_first[:3, 3])
            self.off_m = max(self.off_m, float(np.linalg.norm(answer.T_map_lidar[:3, 3] - expected_m)))

    def _world(self, scans_ago: float = 0.0) -> np.ndarray:
        return self.way((self.seq - scans_ago) * FRAME_NS * 1e-9)

    def _fix(self) -> GnssFix:
        antenna = self._world(0.5) @ [*LEVER_M, 1.0]
        enu = T_ENU_WORLD @ antenna + np.append(self._rng.normal(0, GNSS_SIGMA_M, 3), 0.0)
        self.first_enu_m = enu[:3] if self.first_enu_m is None else self.first_enu_m
        ((latitude, longitude, altitude),) = enu_to_wgs84(enu[None, :3], DATUM)
        covariance = np.eye(3) * GNSS_SIGMA_M**2
        stamp_ns = round((self.seq - 0.5) * FRAME_NS)
        return GnssFix(stamp_ns, float(latitude), float(longitude), float(altitude), covariance)

    def matched_on_the_lorry(self) -> float:
        """Share of points on the lorry's near side that the local map has a plane for."""
        centre, half = np.array(LORRY_AT_M), np.array(LORRY_M) / 2.0
        along = np.linspace(-0.8, 0.8, 40) * half[0]
        side = np.column_stack([centre[0] + along, np.full(40, centre[1] + half[1]), np.full(40, 1.5), np.ones(40)])
        T_local_world = se3.inv(self.pipeline.map_frame.T_map_local) @ se3.inv(self.way(FRAME_NS * 1e-9))
        fits = np.empty((40, kernels.GEOMETRY))
        self.pipeline.tracker.local_map.surfs.match((side @ T_local_world.T)[:, :3].copy(), np.eye(4), 0.1, fits)
        return float(np.mean(fits[:, kernels.KIND] == kernels.PLANE))


def test_fixes_that_come_on_old_ground_place_the_whole_map_and_then_add_no_more():
    rounds = Rounds(gnss=True)
    rounds.drive(LAP + LAP // 2)
    keyframes, gnss = len(rounds.pipeline.keyframes), rounds.pipeline.gnss
    assert gnss is not None
    assert rounds.pipeline.graph.T_enu_map is None
    rounds.drive(LAP, fixes=True)
    factors, skipped = rounds.pipeline.stats.gnss_factors, gnss.rejected["spacing"]
    assert factors >= 4
    assert len(rounds.pipeline.keyframes) <= bars.GROWTH_BY_TIME * keyframes
    T_enu_map = rounds.pipeline.graph.T_enu_map
    assert T_enu_map is not None
    expected = T_ENU_WORLD @ rounds.way(FRAME_NS * 1e-9)
    assert rounds.first_enu_m is not None
    assert np.linalg.norm(T_enu_map[:3, 3] - expected[:3, 3] + rounds.first_enu_m) < bars.GNSS_ON_OLD_GROUND_M
    assert abs(se3.angle(se3.inv(T_enu_map) @ expected)) < bars.GNSS_ON_OLD_GROUND_RAD
    rounds.drive(LAP, fixes=True)
    assert rounds.pipeline.stats.gnss_factors <= 1.25 * factors
    assert gnss.rejected["spacing"] > skipped + LAP // 4
    assert rounds.off_m < bars.SAME_GROUND_OFF_M


def test_a_place_that_has_changed_is_learnt_once():
    rounds = Rounds()
    rounds.drive(2 * LAP + LAP // 2)
    keyframes = len(rounds.pipeline.keyframes)
    rounds.drive(LAP)
    unchanged = len(rounds.pipeline.keyframes) - keyframes
    assert rounds.matched_on_the_lorry() == 0.0
    rounds.town.parked = True
    rounds.drive(LAP)
    learnt = len(rounds.pipeline.keyframes) - keyframes - unchanged
    assert learnt > unchanged
    assert rounds.matched_on_the_lorry() > 0.5
    assert rounds.off_m < bars.SAME_GROUND_OFF_M
    rounds.drive(LAP)
    again = len(rounds.pipeline.keyframes) - keyframes - unchanged - learnt
    assert again <= (bars.GROWTH_BY_TIME - 1.0) * keyframes
    assert rounds.off_m < bars.SAME_GROUND_OFF_M


@pytest.fixture(scope="module")
def in_parts() -> Rounds:
    """Half a lap; a map that is made anew gets 4,000 points a scan."""
    loops = LoopSettings(apply_after_frames=5)
    rounds = Rounds(settings=PipelineSettings(loops=loops, graph=GraphSettings(rebuild_points=4000)))
    rounds.drive(LAP // 2)
    return rounds


def test_a_map_is_made_anew_in_parts_and_the_robot_goes_on_in_the_old_one(in_parts: Rounds):
    pipeline = in_parts.pipeline
    largest, parts = max(pipeline.keyframes[i].cloud.count for i in range(len(pipeline.keyframes))), []
    count = len(pipeline.keyframes)
    pipeline.map_frame.renew(pipeline.tracker, pipeline.keyframes, pipeline.graph.poses)
    renewal = pipeline.map_frame._renewal
    assert renewal is not None
    while pipeline.map_frame.renewing:
        assert voxels(pipeline.tracker.local_map) != voxels(renewal.local_map)
        before = set(renewal.local_map.keyframes)
        in_parts.drive(1)
        new = renewal.local_map.keyframes - before
        parts.append(sum(pipeline.keyframes[i].cloud.count for i in new))
        assert in_parts.off_m < bars.SAME_GROUND_OFF_M
    assert len(parts) > 5
    assert max(parts) < 4000 + largest
    assert len(pipeline.keyframes) > count  # on new ground, while it was made
    assert pipeline.tracker.local_map.keyframes == set(range(len(pipeline.keyframes)))
    assert voxels(pipeline.tracker.local_map) == voxels(filled_anew(pipeline))
    in_parts.drive(20)
    assert in_parts.off_m < bars.SAME_GROUND_OFF_M


def test_a_correction_meanwhile_is_taken_over_with_the_new_map(in_parts: Rounds):
    pipeline, frame = in_parts.pipeline, in_parts.pipeline.map_frame
    state = pipeline.tracker.state
    assert state is not None
    before = frame.T_map_local @ state.T_local_lidar
    frame.renew(pipeline.tracker, pipeline.keyframes, pipeline.graph.poses)
    frame.go_on(pipeline.tracker, pipeline.keyframes, pipeline.graph.poses)
    correction = se3.exp(np.array([0.0, 0.0, 0.01, 0.3, -0.2, 0.0]))
    corrected = Poses(correction @ T for T in pipeline.graph.poses)
    frame.correct(pipeline.ground.reference, pipeline.keyframes, corrected)
    while frame.renewing:
        frame.go_on(pipeline.tracker, pipeline.keyframes, corrected)
    state = pipeline.tracker.state
    assert state is not None
    np.testing.assert_allclose(frame.T_map_local @ state.T_local_lidar, correction @ before, atol=1e-6)
    np.testing.assert_allclose(frame.poses_local(corrected), pipeline.keyframes.poses_local(), atol=1e-6)
