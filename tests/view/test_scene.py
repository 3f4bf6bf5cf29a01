"""What is shown of a robot, by what is logged."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from splitslam import se3
from splitslam.view.colours import colours_of
from splitslam.view.records import Correction, Features, ScanShown
from splitslam.view.robot_scene import COVARIANCE_SCALE
from splitslam.view.scene import TIMELINE, Scene
from splitslam.view.strips import LONGEST
from tests.tolerances import VIEW_M
from tests.view.logged import Logged, points, pose

STEP_NS = 100_000_000
START_NS = 1_700_000_000_123_456_789
RNG = np.random.default_rng(5)
CLOUD = RNG.normal(size=(200, 3)).astype(np.float32) * 10


def at(x_m: float, yaw_rad: float = 0.0) -> np.ndarray:
    return se3.compose(se3.so3_exp(np.array([0.0, 0.0, yaw_rad])), np.array([x_m, 1.0, 0.5]))


def scan(k: int, keyframe: int = 0, **changes) -> ScanShown:
    values = {"stamp_ns": START_NS + k * STEP_NS, "T_map_lidar": at(0.1 * k), "state": "tracking", "keyframe": keyframe}
    return ScanShown(**(values | changes))


def moved(T: np.ndarray, points_map: np.ndarray) -> np.ndarray:
    return points_map @ T[:3, :3].T + T[:3, 3]


def test_a_correction_moves_a_keyframe_without_logging_a_point_of_it_again() -> None:
    logged = Logged()
    robot = Scene(logged, voxel_m=0.0).robot("r")  # type: ignore[arg-type]
    robot.keyframe(START_NS, 0, at(1.0), CLOUD)
    robot.move(START_NS + STEP_NS, {0: at(2.0, 0.3)})
    (cloud,) = logged.of("world/r/map/newest/0", "Points3D")
    np.testing.assert_array_equal(points(cloud), CLOUD)
    assert [pose(entry)[0, 3] for entry in logged.of("world/r/map/newest/0", "Transform3D")] == [1.0, 2.0]
    np.testing.assert_allclose(logged.map_of("r"), moved(at(2.0, 0.3), CLOUD), atol=VIEW_M)
    robot.keyframe(START_NS, 0, at(2.0, 0.3), CLOUD)
    assert len(logged.of("world/r/map/newest/0", "Points3D")) == 1


def test_the_corrected_way_moves_with_its_keyframe_and_the_one_as_answered_stays() -> None:
    logged = Logged()
    robot = Scene(logged, voxel_m=0.0).robot("r")  # type: ignore[arg-type]
    robot.keyframe(START_NS, 0, at(0.0), CLOUD)
    answered = [at(0.1 * k) for k in range(8)]
    for k, T in enumerate(answered):
        robot.scan(scan(k, T_map_lidar=T))
    expected = np.array([T[:3, 3] for T in answered])
    np.testing.assert_allclose(logged.way_of("r")[-1], expected, atol=VIEW_M)
    correction = at(5.0, 0.5) @ se3.inv(at(0.0))
    robot.move(START_NS + 8 * STEP_NS, {0: correction @ at(0.0)})
    np.testing.assert_allclose(logged.way_of("r")[-1], moved(correction, expected), atol=VIEW_M)
    online = np.array(logged.of("world/r/online/newest")[-1].fields["strips"][0])
    np.testing.assert_allclose(online, expected, atol=VIEW_M)


def test_a_long_way_costs_no_more_a_scan_than_a_short_one_and_has_no_gaps() -> None:
    logged = Logged()
    robot = Scene(logged, voxel_m=0.0).robot("r")  # type: ignore[arg-type]
    robot.keyframe(START_NS, 0, at(0.0), CLOUD)
    for k in range(3 * LONGEST):
        robot.scan(scan(k))
    sizes = [len(entry.fields["strips"][0]) for entry in logged.of("world/r/online/newest")]
    assert max(sizes) <= LONGEST + 1
    assert len(logged.of("world/r/online/0")) == 2, "once for each piece that is full"
    whole = [
        *logged.of("world/r/online/0")[-1].fields["strips"],
        logged.of("world/r/online/newest")[-1].fields["strips"][0],
    ]
    assert all(before[-1] == after[0] for before, after in itertools.pairwise(whole))
    assert [len(piece) for piece in logged.way_of("r")[:2]] == [LONGEST + 1] * 2


def test_a_robot_that_stands_draws_nothing() -> None:
    logged = Logged()
    robot = Scene(logged, voxel_m=0.0).robot("r")  # type: ignore[arg-type]
    robot.keyframe(START_NS, 0, at(0.0), CLOUD)
    for k in range(100):
        robot.scan(scan(k, T_map_lidar=at(0.001 * (k % 2))))
    assert [len(logged.of(path)) for path in logged.paths("world/r/online/")] == [1]


def test_the_ways_of_neighbouring_keyframes_join() -> None:
    logged = Logged()
    robot = Scene(logged, voxel_m=0.0).robot("r")  # type: ignore[arg-type]
    robot.keyframe(START_NS, 0, at(0.0), CLOUD)
    for k in range(10):
        robot.scan(scan(k))
    robot.keyframe(START_NS, 1, at(1.0, 0.2), CLOUD)
    for k in range(10, 20):
        robot.scan(scan(k, keyframe=1))
    before, after = logged.way_of("r")
    np.testing.assert_allclose(after[0], before[-1], atol=VIEW_M)


def test_features_lie_in_the_scans_own_frame_and_correspondences_join_them_with_the_map() -> None:
    logged = Logged()
    robot = Scene(logged, voxel_m=0.0).robot("r")  # type: ignore[arg-type]
    matches = CLOUD[:5] + np.float32(0.1)
    matches[2] = np.nan
    robot.scan(scan(0, features=Features(CLOUD[:5], CLOUD[5:9], matches, CLOUD[5:9])))
    np.testing.assert_array_equal(points(logged.of("world/r/lidar/corners")[0]), CLOUD[:5])
    np.testing.assert_array_equal(points(logged.of("world/r/lidar/surfs")[0]), CLOUD[5:9])
    lines = np.array(logged.of("world/r/lidar/matches")[0].fields["strips"])
    assert lines.shape == (8, 2, 3)
    np.testing.assert_allclose(lines[:4, 0], CLOUD[[0, 1, 3, 4]])
    np.testing.assert_allclose(lines[:4, 1], matches[[0, 1, 3, 4]])


def test_the_ellipsoid_has_the_covariance_that_was_answered() -> None:
    logged = Logged()
    robot = Scene(logged, voxel_m=0.0).robot("r")  # type: ignore[arg-type]
    R = se3.so3_exp(np.array([0.3, -0.5, 0.8]))
    sigmas_m = np.array([0.001, 0.004, 0.02])
    covariance = np.zeros((6, 6))
    covariance[3:, 3:] = R @ np.diag(sigmas_m**2) @ R.T
    robot.scan(scan(0, covariance=covariance))
    (entry,) = logged.of("world/r/lidar/covariance")
    half = np.array(entry.fields["half_sizes"][0]) / (3.0 * COVARIANCE_SCALE)
    drawn = se3.matrix_from_quat(np.array(entry.fields["quaternions"][0]))
    np.testing.assert_allclose(drawn @ np.diag(half**2) @ drawn.T, covariance[3:, 3:], rtol=1e-3, atol=1e-9)
    assert logged.of("doubt/r/position")[0].fields["scalars"] == pytest.approx([20.0])


def test_loops_and_fixes_are_lines_between_where_their_keyframes_are_now() -> None:
    logged = Logged()
    robot = Scene(logged, voxel_m=0.0).robot("r")  # type: ignore[arg-type]
    for index, x_m in enumerate((0.0, 5.0, 9.0)):
        robot.keyframe(START_NS, index, at(x_m), CLOUD)
    robot.move(START_NS, {2: at(0.2)})
    robot.loops(START_NS, [(0, 2), (1, 7)])  # 7 has not been told of yet
    np.testing.assert_allclose(logged.of("world/r/loops")[-1].fields["strips"], [[at(0.0)[:3, 3], at(0.2)[:3, 3]]])
    robot.fixes(START_NS, [1, 7], np.array([[5.0, 2.0, 1.0], [7.0, 7.0, 7.0]]))
    assert len(points(logged.of("world/r/gnss/fixes")[-1])) == 2
    np.testing.assert_allclose(logged.of("world/r/gnss/factors")[-1].fields["strips"], [[at(5.0)[:3, 3], [5, 2, 1]]])


def test_plots_are_in_kbit_a_second_and_milliseconds_by_the_sensors_clock() -> None:
    logged = Logged()
    robot = Scene(logged, voxel_m=0.0).robot("r")  # type: ignore[arg-type]
    for k in range(40):
        robot.scan(scan(k, frame_bytes=1250.0, answer_ms=7.0))
    assert logged.of("uplink/r/kbps")[-1].fields["scalars"] == pytest.approx([100.0])
    assert logged.of("latency/r/answer")[-1].fields["scalars"] == [7.0]
    assert logged.timelines == {TIMELINE}
    assert [entry.stamp_ns for entry in logged.of("world/r/lidar")] == [START_NS + k * STEP_NS for k in range(40)]


def test_what_happens_is_told_in_words() -> None:
    logged = Logged()
    robot = Scene(logged, voxel_m=0.0).robot("r")  # type: ignore[arg-type]
    robot.scan(scan(0))
    robot.scan(scan(1))
    robot.scan(scan(2, state="lost"))
    robot.scan(scan(3, state="tracking", correction=Correction("loop", 0.5, 0.1)))
    said = [(entry.fields["text"][0], entry.fields["level"][0]) for entry in logged.of("events/r")]
    assert said == [
        ("tracking", "INFO"),
        ("lost", "ERROR"),
        ("tracking", "INFO"),
        ("map corrected: loop, 50.0 cm, 5.73 deg", "INFO"),
    ]


def test_two_robots_have_trees_and_colours_of_their_own() -> None:
    logged = Logged()
    scene = Scene(logged, voxel_m=0.0)  # type: ignore[arg-type]
    for name in ("a b", "c/d"):
        robot = scene.robot(name)
        robot.keyframe(START_NS, 0, at(0.0), CLOUD)
        robot.scan(scan(1))
    ways = ["world/a\\ b/trajectory/newest", "world/c\\/d/trajectory/newest"]
    assert len(ways) == 2
    colours = [logged.of(path)[-1].fields["colors"] for path in ways]
    assert colours[0] != colours[1]
    assert colours_of(0) == colours_of(4)


def test_a_map_is_thinned_to_the_first_point_of_each_voxel() -> None:
    logged = Logged()
    robot = Scene(logged, voxel_m=1.0).robot("r")  # type: ignore[arg-type]
    poses = [at(3.0), at(4.0, 1.0)]
    taken: set[tuple[int, ...]] = set()
    for index, T in enumerate(poses):
        robot.keyframe(START_NS, index, T, CLOUD)
        kept = []
        for point in CLOUD:  # naive twin
            cell = tuple(np.floor(T[:3, :3] @ point.astype(np.float64) + T[:3, 3]).astype(int))
            kept += [] if cell in taken else [point]
            taken.add(cell)
        np.testing.assert_array_equal(points(logged.of(f"world/r/map/newest/{index}", "Points3D")[0]), kept)
