"""A partition result with round figures."""

from __future__ import annotations

from splitslam.bench.partition_result import Case, Partition


def partition(**changed: object) -> Partition:
    """100 scans in 10 s: 20,000 raw points of 18 B and 40,000 B of IMU a scan; ours 4,000 B."""
    image, features = {"motion": 0.5, "deskew": 1.5}, {"features": 1.0}
    values: dict = {
        "name": "made",
        "scans": 100,
        "recording_s": 10.0,
        "points": 20_000.0,
        "native_bytes": 80_000.0,
        "laz_bytes": 20_000.0,
        "cases": {
            "case1": Case(20_000, 360_000, 40_000, {"pack": 0.1}, image | features),
            "case2": Case(20_000, 420_000, 0, image | {"pack": 0.1}, features),
            "case3": Case(5_000, 60_000, 0, image | features | {"pack": 0.1}, {}),
            "ours": Case(1_500, 4_000, 0, image | features | {"encode": 1.0}, {"decode": 0.5}),
        },
        "ros_bytes": {"case2": 900_000.0, "case3": 850_000.0},
        "edge_max_ms": 7.0,
    }
    return Partition(**(values | changed))
