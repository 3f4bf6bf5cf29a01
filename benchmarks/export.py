"""How much memory, time and disk an export of a large map takes.

    python -m benchmarks.export --points 100 [--formats ply,laz,copc,e57,grid] [--voxel 0.1] [--out DIR]

A map of so many million points is made up while it is written: keyframes of 20,000 points a metre along a way of ten
kilometres and more, that turns and comes back, walls and ground about each. Every format is written by a process of its
own, through the writers of `splitslam export`; its peak memory is what the kernel says at its end.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from splitslam import se3
from splitslam.export.command import cloud_writer
from splitslam.export.grid.nav2 import write_grid
from splitslam.export.grid.settings import GridSettings
from splitslam.export.placing import InUtm
from splitslam.maps import Georeference, MapPiece
from splitslam.thinning import TakenVoxels

POINTS_A_KEYFRAME = 20_000
FORMATS = ("ply", "pcd", "las", "laz", "copc", "e57", "grid")
_SOMEWHERE = Georeference(35.5, 139.6, 30.0, se3.exp(np.array([0.0, 0.0, 0.7, 12.0, -7.0, 1.5])))
_LAP_M = 5000.0


@dataclass(frozen=True, slots=True)
class Cost:
    """One export. memory_mb: peak, all of the process."""

    format: str
    points: int
    memory_mb: float
    wall_s: float
    cpu_s: float
    file_mb: float


def made_map(points: int, voxel_m: float = 0.0) -> Iterator[MapPiece]:
    """Keyframes a metre apart on laps of 5 km, each a little beside the one before; `points` before thinning."""
    with TakenVoxels(voxel_m or 1.0) as taken:
        for k in range(points // POINTS_A_KEYFRAME):
            rng = np.random.default_rng(k)
            angle = 2 * np.pi * (k % _LAP_M) / _LAP_M
            radius_m = _LAP_M / (2 * np.pi) + 15.0 * (k // _LAP_M)
            centre = np.array([radius_m * np.sin(angle), radius_m * (1.0 - np.cos(angle)), 0.0])
            T = se3.compose(se3.so3_exp(np.array([0.0, 0.0, angle])), centre)
            local = rng.uniform(-40.0, 40.0, (POINTS_A_KEYFRAME, 3)) * [1.0, 1.0, 0.0]
            wall = rng.random(POINTS_A_KEYFRAME) < 0.5
            local[wall, 1] = np.where(local[wall, 1] > 0, 12.0, -12.0)
            local[:, 2] = np.where(wall, rng.uniform(-1.0, 5.0, POINTS_A_KEYFRAME), -1.0)
            in_map = local @ T[:3, :3].T + T[:3, 3]
            shade = rng.integers(0, 256, POINTS_A_KEYFRAME)
            rows = taken.first(in_map) if voxel_m else slice(None)
            piece = np.column_stack([in_map[rows], shade[rows]]).astype("<f4")
            yield MapPiece(k, 1_700_000_000_000_000_000 + k * 700_000_000, T, piece)


def cost_of(name: str, points: int, voxel_m: float, out: Path) -> Cost:
    """Writes one format here and now."""
    start_s, start_cpu_s = time.monotonic(), time.process_time()
    path = out / f"map.{name}"
    if name == "grid":
        settings = GridSettings(resolution_m=0.1)
        write_grid(path, out / "map.pgm", "map.pgm", made_map(points, voxel_m), settings)
        path, written = out / "map.pgm", points
    else:
        written = cloud_writer(name)(path, made_map(points, voxel_m), InUtm(_SOMEWHERE), "made")
    wall_s, cpu_s = round(time.monotonic() - start_s, 1), round(time.process_time() - start_cpu_s, 1)
    peak_mb = _peak_mb()
    return Cost(name, written, round(peak_mb), wall_s, cpu_s, round(path.stat().st_size / 1e6))


def _peak_mb() -> float:
    """Of this program alone: ru_maxrss would be that of a large process which has started it."""
    line = next(l for l in Path("/proc/self/status").read_text().splitlines() if l.startswith("VmHWM:"))
    return int(line.split()[1]) / 1024


def measured(name: str, points: int, voxel_m: float = 0.0, folder: Path | None = None) -> Cost:
    """The same in a process of its own; what it writes is thrown away, the folder made if need be."""
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder) as out:
        arguments = ["--one", name, "--points", str(points / 1e6), "--voxel", str(voxel_m), "--out", out]
        command = [sys.executable, "-m", "benchmarks.export", *arguments]
        done = subprocess.run(command, check=True, capture_output=True, text=True, cwd=Path(__file__).parents[1])
        return Cost(**json.loads(done.stdout))


def main() -> None:
    """Prints a line for each format."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=float, default=100.0, help="millions")
    parser.add_argument("--formats", default=",".join(FORMATS))
    parser.add_argument("--voxel", type=float, default=0.0, help="m; one point a voxel")
    parser.add_argument("--out", type=Path, help="where there is room")
    parser.add_argument("--one", help=argparse.SUPPRESS)
    given = parser.parse_args()
    points = round(given.points * 1e6)
    if given.one:
        from dataclasses import asdict

        print(json.dumps(asdict(cost_of(given.one, points, given.voxel, given.out))))
        return
    print("| format | points | peak memory, MB | wall, s | CPU, s | file, MB |\n|---|---|---|---|---|---|")
    for name in given.formats.split(","):
        c = measured(name, points, given.voxel, given.out)
        print(f"| {c.format} | {c.points} | {c.memory_mb:.0f} | {c.wall_s} | {c.cpu_s} | {c.file_mb:.0f} |", flush=True)


if __name__ == "__main__":
    main()
