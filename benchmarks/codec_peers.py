"""Draco and LAZ on point clouds. Runs in .venv-bench, without splitslam: codec_peers.py IN.npz OUT.json."""

from __future__ import annotations

import io
import json
import sys
import time
from collections.abc import Callable
from typing import Any

import DracoPy  # pyright: ignore[reportMissingImports]
import laspy  # pyright: ignore[reportMissingImports]
import numpy as np

_REPEATS = 3


def cpu_ms(call: Callable[[], Any]) -> float:
    """The best of some, since other programs share the machine."""
    times = []
    for _ in range(_REPEATS):
        before = time.process_time()
        call()
        times.append(time.process_time() - before)
    return 1e3 * min(times)


def draco(points: np.ndarray, step_m: float) -> tuple[Callable[[], bytes], Callable[[bytes], np.ndarray]]:
    low = points.min(axis=0) - 0.5 * step_m
    bits = int(np.ceil(np.log2((points.max(axis=0) - low).max() / step_m + 1)))
    span = step_m * (2**bits - 1)  # so that a step is step_m

    def encode() -> bytes:
        return DracoPy.encode(
            points, quantization_bits=bits, compression_level=10, quantization_range=span, quantization_origin=low
        )

    return encode, lambda data: np.asarray(DracoPy.decode(data).points)


def laz(points: np.ndarray, step_m: float) -> tuple[Callable[[], bytes], Callable[[bytes], np.ndarray]]:
    def encode() -> bytes:
        header = laspy.LasHeader(point_format=0, version="1.2")
        header.scales, header.offsets = np.full(3, step_m), np.zeros(3)
        cloud = laspy.LasData(header)
        cloud.x, cloud.y, cloud.z = points.astype(np.float64).T
        out = io.BytesIO()
        cloud.write(out, do_compress=True, laz_backend=laspy.LazBackend.Lazrs)
        return out.getvalue()

    return encode, lambda data: np.asarray(laspy.read(io.BytesIO(data)).xyz)


def nearest_error_m(points: np.ndarray, decoded: np.ndarray) -> float:
    """Mean distance to the decoded point; Draco has them in an order of its own, so to the nearest."""
    if len(points) == len(decoded) and np.abs(points - decoded).max() < 1.0:
        return float(np.linalg.norm(points - decoded, axis=1).mean())
    parts = [np.linalg.norm(decoded - p, axis=1).min() for p in points[:: max(1, len(points) // 200)]]
    return float(np.mean(parts))


def main() -> None:
    clouds = np.load(sys.argv[1])
    step_m = float(clouds["step_m"])
    rows = []
    for name in (n for n in clouds.files if n != "step_m"):
        points = clouds[name]
        for method, make in (("Draco", draco), ("LAZ", laz)):
            encode, decode = make(points, step_m)
            data = encode()
            rows.append(
                {
                    "frame": name,
                    "method": method,
                    "bytes": len(data),
                    "error_m": nearest_error_m(points, decode(data)),
                    "encode_ms": cpu_ms(encode),
                    "decode_ms": cpu_ms(lambda d=data, f=decode: f(d)),
                }
            )
    with open(sys.argv[2], "w") as file:
        json.dump(rows, file)


if __name__ == "__main__":
    main()
