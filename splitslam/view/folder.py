"""A finished run's folder: its map by keyframes, its trajectories, and what went over the link."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from splitslam import se3
from splitslam.errors import InputError
from splitslam.ply import read_points
from splitslam.run.tables import KeyframeRow, ScanRow, read_keyframes, read_scans
from splitslam.tum import Trajectory, read_tum
from splitslam.view.history import KeyframeStamps, in_own_frame
from splitslam.view.records import Array, ScanShown
from splitslam.view.robot_scene import RobotScene
from splitslam.view.scene import Scene

RECORDING = "view.rrd"
_UPPER = np.triu_indices(6)


@dataclass(frozen=True, slots=True, eq=False)
class RunFolder:
    """What there is of a run. points_map: (N, 4) x y z intensity, mapped into memory. keyframes: [] of an older run's.

    loops: (older, newer) keyframe. covariances: (6, 6) and state by stamp.
    """

    name: str
    trajectory: Trajectory
    online: Trajectory
    points_map: NDArray[np.float32]
    keyframes: list[KeyframeRow]
    scans: dict[int, ScanRow]
    covariances: dict[int, tuple[str, Array]]
    loops: list[tuple[int, int]]


def read_folder(folder: Path) -> RunFolder:
    """Raises InputError that names the file that is missing or cannot be read, and what was expected."""
    report = folder / "report.json"
    try:
        found = json.loads(report.read_text())
        session_id, loops = found.get("session_id", ""), found.get("loop_keyframes") or []
        pairs = [(int(older), int(newer)) for older, newer in loops]
    except (OSError, ValueError, TypeError, AttributeError) as error:
        raise InputError(f"{report}: expected the report of a run of `splitslam run` ({error})") from None
    points_map = read_points(folder / "map.ply")
    keyframes = _optional(folder / "keyframes.csv", read_keyframes)
    if keyframes and sum(row.points for row in keyframes) != len(points_map):
        raise InputError(f"{folder / 'keyframes.csv'}: expected the {len(points_map)} points of map.ply in all")
    return RunFolder(
        name=session_id.partition("/")[0] or folder.absolute().name,
        trajectory=read_tum(folder / "trajectory.tum"),
        online=read_tum(folder / "online.tum"),
        points_map=points_map,
        keyframes=keyframes,
        scans={row.stamp_ns: row for row in _optional(folder / "scans.csv", read_scans)},
        covariances=dict(_optional(folder / "online_covariance.csv", lambda path: list(_covariances(path)))),
        loops=pairs,
    )


def _optional(path, read):
    return read(path) if path.exists() else []


def _covariances(path: Path) -> Iterator[tuple[int, tuple[str, Array]]]:
    with path.open(encoding="ascii", errors="replace", newline="") as file:
        for number, line in enumerate(csv.reader(file), start=1):
            if number == 1 or not line:
                continue
            try:
                upper = np.zeros((6, 6))
                upper[_UPPER] = [float(value) for value in line[2:]]
                yield int(line[0]), (line[1], upper + np.triu(upper, 1).T)
            except (ValueError, IndexError):
                raise InputError(f"{path}:{number}: expected stamp_ns, state and 21 numbers") from None


def show_folder(run: RunFolder, scene: Scene) -> None:
    """The drive as it went: each scan's pose as it was answered, the map and the way as they ended."""
    robot = scene.robot(run.name)
    taken_ns = _show_map(run, robot)
    order = sorted(taken_ns, key=lambda keyframe: taken_ns[keyframe])
    starts_ns = [taken_ns[keyframe] for keyframe in order]
    final = _poses(run.trajectory)
    for stamp_ns, T_online in _poses(run.online).items():
        k = int(np.searchsorted(starts_ns, stamp_ns, side="right")) - 1
        keyframe = order[k] if k >= 0 else 0
        state, covariance = run.covariances.get(stamp_ns, ("mapped", None))
        scan = run.scans.get(stamp_ns)
        shown = ScanShown(
            stamp_ns,
            T_online,
            state,
            keyframe,
            covariance,
            frame_bytes=scan.bytes if scan else np.nan,
            round_trip_ms=np.nan if scan is None or scan.round_trip_ms is None else scan.round_trip_ms,
        )
        robot.scan(shown, T_corrected=final.get(stamp_ns))
    if run.loops and taken_ns:
        robot.loops(scene.latest_ns, run.loops)


def _poses(trajectory: Trajectory) -> dict[int, Array]:
    """T (4, 4) by stamp, in order of time."""
    rows = zip(trajectory.stamps_ns.tolist(), trajectory.positions_m, trajectory.quats_xyzw, strict=True)
    return {stamp_ns: se3.from_quat(position, quat) for stamp_ns, position, quat in rows}


def _show_map(run: RunFolder, robot: RobotScene) -> dict[int, int]:
    """Stamps of the keyframes, ns. A map without a table of them is one keyframe, there from the start."""
    first_ns = int(run.trajectory.stamps_ns[0])
    if not run.keyframes:
        robot.keyframe(first_ns, 0, np.eye(4), np.array(run.points_map[:, :3]))
        return {0: first_ns}
    stamps, taken_ns, at = KeyframeStamps(run.trajectory), {}, 0
    for row in run.keyframes:
        T = se3.from_quat(np.array(row.pose[:3]), np.array(row.pose[3:]))
        taken_ns[row.keyframe] = stamp_ns = stamps.of(T[:3, 3])
        points = in_own_frame(run.points_map[at : at + row.points, :3], T)
        robot.stored_keyframe(stamp_ns, row.keyframe, T, points)
        at += row.points
    robot.settle()
    return taken_ns
