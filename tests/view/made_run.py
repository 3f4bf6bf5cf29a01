"""The folder of a run that never was: a lap in a walled yard, every point of it known."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from splitslam import se3
from splitslam.ply import write_ply
from splitslam.run.tables import KeyframeRow, write_keyframes, write_scans
from splitslam.tum import Trajectory, write_tum

START_NS, STEP_NS = 1_700_000_000_000_000_000, 100_000_000
SCANS, EVERY = 120, 10
HALF_M, HEIGHT_M = 12.0, 4.0
OFF_M = 0.4  # of what was answered at the end, against the corrected way


def poses() -> list[np.ndarray]:
    """T_map_lidar of all scans: a circle of 6 m."""
    angles = np.linspace(0.0, 2.0 * np.pi, SCANS)
    return [
        se3.compose(se3.so3_exp(np.array([0, 0, a])), np.array([6 * np.sin(a), 6 - 6 * np.cos(a) - 6, 1.0]))
        for a in angles
    ]


def walls() -> np.ndarray:
    """(N, 3) of four walls around the middle and the floor between them, `map`."""
    rng = np.random.default_rng(3)
    along, height = rng.uniform(-HALF_M, HALF_M, 40_000), rng.uniform(0, HEIGHT_M, 40_000)
    side = rng.integers(0, 4, 40_000)
    x = np.where(side < 2, np.where(side == 0, -HALF_M, HALF_M), along)
    y = np.where(side < 2, along, np.where(side == 2, -HALF_M, HALF_M))
    floor = np.column_stack([rng.uniform(-HALF_M, HALF_M, (20_000, 2)), np.zeros(20_000)])
    return np.concatenate([np.column_stack([x, y, height]), floor])


def write_run(folder: Path) -> None:
    """As `splitslam run` leaves it."""
    stamps_ns = START_NS + STEP_NS * np.arange(SCANS)
    way = poses()
    quats = np.array([se3.quat_from_matrix(T[:3, :3]) for T in way])
    positions = np.array([T[:3, 3] for T in way])
    write_tum(folder / "trajectory.tum", Trajectory(stamps_ns, positions, quats))
    off = np.linspace(0.0, OFF_M, SCANS)[:, None] * np.array([1.0, 1.0, 0.0])
    write_tum(folder / "online.tum", Trajectory(stamps_ns, positions + off, quats))
    points = np.column_stack([walls(), np.zeros(len(walls()))]).astype("<f4")
    parts = np.array_split(points, SCANS // EVERY)
    write_ply(folder / "map.ply", (part.tobytes() for part in parts))
    rows = []
    for k, part in enumerate(parts):
        position, quat = positions[k * EVERY], quats[k * EVERY]
        rows.append(KeyframeRow(k, len(part), (*position.tolist(), *quat.tolist())))  # type: ignore[arg-type]
    write_keyframes(folder / "keyframes.csv", rows)
    write_scans(
        folder / "scans.csv",
        {
            "stamps_ns_by_scan": stamps_ns.tolist(),
            "bytes_by_scan": [1250] * SCANS,
            "dense_by_scan": [k % EVERY == 0 for k in range(SCANS)],
            "round_trip_ms_by_scan": [None, *([5.0] * (SCANS - 1))],
        },
    )
    covariance = ",".join("1e-6" if i == j else "0" for i in range(6) for j in range(i, 6))
    lines = [f"{stamp_ns},tracking,{covariance}" for stamp_ns in stamps_ns]
    (folder / "online_covariance.csv").write_text("\n".join(["stamp_ns,state,...", *lines]) + "\n")
    report = {"session_id": "rover-7/1", "loop_keyframes": [[0, SCANS // EVERY - 1]]}
    (folder / "report.json").write_text(json.dumps(report))
