"""Keyframes in blocks: a long drive is few entities, and each point and piece of the way is drawn once, in place."""

from __future__ import annotations

import numpy as np

from splitslam import se3
from splitslam.view.keyframe_blocks import BLOCK, NEWEST
from splitslam.view.robot_scene import RobotScene
from splitslam.view.scene import Scene
from tests.tolerances import VIEW_M
from tests.view.logged import Logged, points
from tests.view.test_scene import START_NS, STEP_NS, at, moved, scan

RNG = np.random.default_rng(3)
KEYFRAMES = 3 * BLOCK + 5
CLOUDS = RNG.normal(size=(KEYFRAMES, 20, 3)).astype(np.float32)
POSES = [at(0.5 * k, 0.01 * k) for k in range(KEYFRAMES)]


def drive(poses: list[np.ndarray] = POSES) -> tuple[Logged, RobotScene]:
    """A scan at each keyframe, and one after it that hangs on it."""
    logged = Logged()
    robot = Scene(logged, voxel_m=0.0).robot("r")  # type: ignore[arg-type]
    for k, T in enumerate(poses):
        robot.keyframe(stamp(k), k, T, CLOUDS[k])
        robot.scan(scan(2 * k, k, T_map_lidar=T))
        robot.scan(scan(2 * k + 1, k, T_map_lidar=T @ se3.compose(np.eye(3), np.array([0.25, 0.0, 0.0]))))
    return logged, robot


def stamp(k: int) -> int:
    return START_NS + 2 * k * STEP_NS


def clouds_map(poses: list[np.ndarray] = POSES) -> np.ndarray:
    return np.concatenate([moved(T, CLOUDS[k]) for k, T in enumerate(poses)])


def same(drawn: np.ndarray, expected: np.ndarray, off_m: float = VIEW_M) -> bool:
    """The same points, in whatever order: neighbours are far further apart than the tolerance."""
    off = np.linalg.norm(drawn[:, None] - expected[None], axis=2)
    return len(drawn) == len(expected) and off.min(axis=0).max() <= off_m and off.min(axis=1).max() <= off_m


def clouds_logged(logged: Logged) -> int:
    return sum(len(logged.of(path, "Points3D")) for path in logged.paths("world/r/map/"))


def test_every_point_is_there_once_and_the_entities_are_few() -> None:
    logged, _ = drive()
    assert same(logged.map_of("r"), clouds_map())
    assert len(logged.paths("world/r/map/")) == NEWEST + 3
    assert len(logged.paths("world/r/trajectory/")) == 3 + 1 + 1
    folds = 3 * BLOCK // NEWEST
    assert clouds_logged(logged) == KEYFRAMES + folds * (1 + NEWEST), "each keyframe; each fold, and what it empties"


def test_a_correction_of_the_whole_map_logs_transforms_alone() -> None:
    logged, robot = drive()
    before, correction = clouds_logged(logged), at(5.0, 0.4)
    poses = [correction @ T for T in POSES]
    robot.move(stamp(KEYFRAMES), dict(enumerate(poses)))
    assert clouds_logged(logged) == before
    assert same(logged.map_of("r"), clouds_map(poses))
    ways = np.concatenate(logged.way_of("r"))
    near = np.linalg.norm(ways[:, None] - np.array([T[:3, 3] for T in poses])[None], axis=2).min(axis=0)
    assert near.max() < VIEW_M, "and the way has gone with it"


def test_a_block_that_is_bent_is_drawn_anew_and_the_others_are_not() -> None:
    logged, robot = drive()
    poses = list(POSES)
    for k in range(BLOCK + BLOCK // 2, 2 * BLOCK):
        poses[k] = se3.compose(POSES[k][:3, :3], POSES[k][:3, 3] + [0.3, 0.0, 0.0])
    robot.move(stamp(KEYFRAMES), {k: poses[k] for k in range(KEYFRAMES)})
    assert [len(logged.of(f"world/r/map/{n}", "Points3D")) for n in range(3)] == [4, 5, 4], "folded four times each"
    assert same(logged.map_of("r"), clouds_map(poses))


def test_what_the_eye_does_not_see_is_not_drawn_anew_however_often_it_comes() -> None:
    """A little each time, and what adds up to more is drawn where it belongs."""
    logged, robot = drive()
    poses = list(POSES)
    for step in range(1, 41):
        for k in range(1, BLOCK, 2):
            poses[k] = se3.compose(poses[k][:3, :3], poses[k][:3, 3] + [0.005, 0.0, 0.0])
        robot.move(stamp(KEYFRAMES + step), {k: poses[k] for k in range(BLOCK)})
    assert 4 + 2 <= len(logged.of("world/r/map/0", "Points3D")) <= 4 + 6
    assert same(logged.map_of("r"), clouds_map(poses), off_m=0.05)


def test_stored_keyframes_come_block_by_block_and_a_late_one_takes_its_place_in_the_newest_picture() -> None:
    logged = Logged()
    robot = Scene(logged, voxel_m=0.0).robot("r")  # type: ignore[arg-type]
    late = BLOCK // 2
    robot.move(stamp(KEYFRAMES), dict(enumerate(POSES)))
    for k in range(KEYFRAMES - 3):
        if k != late:
            robot.stored_keyframe(stamp(k), k, POSES[k], CLOUDS[k])
    robot.settle()
    assert robot.without_points == [late, *range(KEYFRAMES - 3, KEYFRAMES)]
    for k in range(KEYFRAMES - 3, KEYFRAMES):
        robot.keyframe(stamp(k), k, POSES[k], CLOUDS[k])
    robot.stored_keyframe(stamp(late), late, POSES[late], CLOUDS[late])
    robot.settle()
    assert same(logged.map_of("r"), clouds_map())
    first = logged.of("world/r/map/0", "Points3D")
    assert len(points(first[-1])) == BLOCK * 20
    assert first[-1].stamp_ns == max(entry.stamp_ns or 0 for entry in first)


def test_a_map_has_no_more_points_than_are_wanted_and_robots_share_them() -> None:
    logged, most = Logged(), 900
    scene = Scene(logged, voxel_m=0.1, most_points=most)  # type: ignore[arg-type]
    robots = [scene.robot("r"), scene.robot("s")]
    for k, T in enumerate(POSES):
        for name, robot in zip("rs", robots, strict=True):
            robot.keyframe(stamp(k), k, T, CLOUDS[k])
            assert len(logged.map_of(name)) <= most // 2
    drawn = logged.map_of("r")
    assert len(drawn) > most // 2 / 4, "and not far fewer"
    off_m = np.linalg.norm(drawn[:, None] - clouds_map()[None], axis=2).min(axis=1)
    assert off_m.max() < VIEW_M, "each of them is one of the map's"
    ahead_m = drawn @ np.array([1.0, 0.0, 0.0])
    assert ahead_m.min() < 2.0 < 45.0 < ahead_m.max(), "from all of the drive"
