"""A partition result with round figures."""

from __future__ import annotations

from splitslam.bench.partition_result import Case, Partition

_IMAGE_MS, _FEATURES_MS = {"motion": 0.5, "deskew": 1.5}, {"features": 1.0}

# 100 scans in 10 s: 20,000 raw points of 18 B and 40,000 B of IMU a scan; ours 4,000 B.
PARTITION = Partition(
    name="made",
    scans=100,
    recording_s=10.0,
    points=20_000.0,
    native_bytes=80_000.0,
    laz_bytes=20_000.0,
    cases={
        "case1": Case(20_000, 360_000, 40_000, {"pack": 0.1}, _IMAGE_MS | _FEATURES_MS),
        "case2": Case(20_000, 420_000, 0, _IMAGE_MS | {"pack": 0.1}, _FEATURES_MS),
        "case3": Case(5_000, 60_000, 0, _IMAGE_MS | _FEATURES_MS | {"pack": 0.1}, {}),
        "ours": Case(1_500, 4_000, 0, _IMAGE_MS | _FEATURES_MS | {"encode": 1.0}, {"decode": 0.5}),
    },
    ros_bytes={"case2": 900_000.0, "case3": 850_000.0},
    edge_max_ms=7.0,
)
