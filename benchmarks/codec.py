"""Bits a point and CPU time of the feature codec, beside what else there is, on the same frames at the same error.

python -m benchmarks.codec [--max-scans N] [--only NAME]: Markdown on stdout, JSON in --out. Draco and LAZ run in
.venv-bench (make bench-setup) and are left out without it. They and zstd carry x, y, z alone; ours carries ring,
column, time, class, intensity of dense frames, motion and knots as well.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import tempfile
from collections import defaultdict
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import zstandard
from numpy.typing import NDArray

from benchmarks.drives import RECORDED, recorded_files
from benchmarks.feature_frames import FrameSource
from benchmarks.peers import PYTHON, ROOT
from benchmarks.timing import best_cpu_ms
from splitslam import codec
from splitslam.codec import version1_encoder
from splitslam.features import FeatureFrame

_EVERY = {True: 1, False: 4}  # of the dense and of the sparse frames
METHODS = ("ours, version 2", "ours, version 1", "Draco", "LAZ", "zstd, int16", "Morton + zstd")
Row = dict[str, Any]


def points_of(frame: FeatureFrame) -> NDArray[np.float32]:
    """(N, 3) of both classes, in scan order."""
    a, b = frame.corners, frame.surfs
    points, ring = np.concatenate([a.points_lidar, b.points_lidar]), np.concatenate([a.ring, b.ring])
    return np.ascontiguousarray(points[np.lexsort((np.concatenate([a.column, b.column]), ring))])


def planes(points: NDArray[np.float32], step_m: float) -> Callable[[], bytes]:
    """Differences between neighbours in scan order as int16 (int32 when they must be), one plane each axis."""

    def encode() -> bytes:
        steps = np.diff(np.rint(points / step_m).astype(np.int32), axis=0, prepend=0)
        kind = np.int16 if np.abs(steps).max() < 1 << 15 else np.int32
        low_and_high = np.ascontiguousarray(steps.T.astype(kind)).view(np.uint8).reshape(3, len(points), -1)
        return zstandard.ZstdCompressor(level=19).compress(low_and_high.transpose(0, 2, 1).tobytes())

    return encode


def morton(points: NDArray[np.float32], step_m: float) -> Callable[[], bytes]:
    """Points sorted by Morton code; the differences of the codes byte by byte."""

    def encode() -> bytes:
        steps = np.rint(points / step_m).astype(np.int64)
        steps -= steps.min(axis=0)
        code = np.zeros(len(steps), np.uint64)
        for bit in range(int(steps.max()).bit_length()):
            for axis in range(3):
                code |= ((steps[:, axis] >> bit) & 1).astype(np.uint64) << np.uint64(3 * bit + axis)
        code.sort()
        apart = np.diff(code, prepend=np.uint64(0)).view(np.uint8).reshape(-1, 8)
        return zstandard.ZstdCompressor(level=19).compress(apart.T.tobytes())

    return encode


def measure(source: FrameSource, step_m: float) -> list[Row]:
    """A row for each frame and method that runs here, and (method Draco, ...) of those in .venv-bench."""
    rows: list[Row] = []
    clouds: dict[str, NDArray[Any]] = {"step_m": np.array(step_m)}
    seen = {True: 0, False: 0}
    for frame in source.frames():
        seen[frame.dense] += 1
        if seen[frame.dense] % _EVERY[frame.dense]:
            continue
        points, beams = points_of(frame), source.beam_elevations_rad
        name = f"{'dense' if frame.dense else 'sparse'}-{frame.seq}"
        clouds[name] = points

        decode = partial(
            codec.decode, seq=frame.seq, stamp_ns=frame.stamp_ns, dense=frame.dense, beam_elevations_rad=beams
        )
        for method, version in ((METHODS[0], codec.encode), (METHODS[1], version1_encoder.encode)):
            encode = partial(version, frame, beams, source.columns, step_m)
            data = encode()
            error_m = np.linalg.norm(points_of(decode(data)) - points, axis=1)
            rows.append(
                {
                    "frame": name,
                    "method": method,
                    "bytes": len(data),
                    "error_m": float(error_m.mean()),
                    "max_error_m": float(error_m.max()),
                    "encode_ms": best_cpu_ms(encode),
                    "decode_ms": best_cpu_ms(partial(decode, data)),
                }
            )
        error_m = np.linalg.norm(np.rint(points / step_m) * step_m - points, axis=1).mean()
        for method, make in ((METHODS[4], planes), (METHODS[5], morton)):
            encode = make(points, step_m)
            rows.append(
                {"frame": name, "method": method, "bytes": len(encode()), "error_m": float(error_m)}
                | {"encode_ms": best_cpu_ms(encode), "decode_ms": None}
            )
    rows += peers(clouds)
    for row in rows:
        row["points"], row["dense"] = len(clouds[row["frame"]]), row["frame"].startswith("dense")
    return rows


def peers(clouds: dict[str, NDArray[Any]]) -> list[Row]:
    """Rows of Draco and LAZ; none without .venv-bench."""
    if not PYTHON.exists():
        return []
    with tempfile.TemporaryDirectory() as folder:
        sent, got = Path(folder) / "clouds.npz", Path(folder) / "rows.json"
        np.savez(sent, allow_pickle=False, **clouds)
        subprocess.run([PYTHON, ROOT / "benchmarks" / "codec_peers.py", sent, got], check=True)
        return json.loads(got.read_text())


def table(name: str, rows: list[Row]) -> str:
    """Markdown: means over frames, bits over all points."""
    lines = [
        "| recording, frames | method | bytes | bits a point | mean error, mm | encode, ms | decode, ms |",
        "|---|---|---|---|---|---|---|",
    ]
    groups: dict[tuple[bool, str], list[Row]] = defaultdict(list)
    for row in rows:
        groups[row["dense"], row["method"]].append(row)
    for dense in (True, False):
        for method in METHODS:
            group = groups.get((dense, method))
            if not group:
                continue
            mean = {key: np.mean([row[key] for row in group]) for key in ("bytes", "points", "error_m", "encode_ms")}
            decode = [row["decode_ms"] for row in group if row["decode_ms"] is not None]
            label = f"`{name}`, {len(group)} {'dense' if dense else 'sparse'} of {mean['points']:.0f} points"
            lines.append(
                f"| {label} | {method} | {mean['bytes']:.0f} | {8 * mean['bytes'] / mean['points']:.1f} "
                f"| {1e3 * mean['error_m']:.1f} | {mean['encode_ms']:.2f} "
                f"| {f'{np.mean(decode):.2f}' if decode else '-'} |"
            )
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--max-scans", type=int, default=300)
    parser.add_argument("--step-m", type=float, default=codec.STEP_M)
    parser.add_argument("--only", choices=[drive.name for drive in RECORDED])
    parser.add_argument("--out", type=Path, default=Path("out/codec"))
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    for drive in RECORDED:
        if arguments.only in (None, drive.name):
            rows = measure(FrameSource(recorded_files(drive), arguments.max_scans), arguments.step_m)
            (arguments.out / f"{drive.name}.json").write_text(json.dumps(rows, indent=1))
            print(table(drive.name, rows) + "\n", flush=True)


if __name__ == "__main__":
    main()
