"""What the partition experiment finds out about a recording: bytes and times of each cut."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from splitslam.bench import paper
from splitslam.bench.break_even import Cut, break_even_mbps, in_words, total_ms
from splitslam.bench.paper import A53_FACTOR

CASES = ("case1", "case2", "case3", "ours")
BANDWIDTHS_MBPS = np.geomspace(1.0, 200.0, 93)


@dataclass(frozen=True, slots=True)
class Case:
    """One cut, means a scan. imu_bytes: of the IMU's messages; bytes: of all else.

    edge_ms: by stage, what the edge does and the packing of what it sends. server_ms: unpacking, and the stages that
    another cut has on the edge.
    """

    points: float
    bytes: float
    imu_bytes: float
    edge_ms: dict[str, float]
    server_ms: dict[str, float]

    def cut(self, edge_factor: float = 1.0) -> Cut:
        """On an edge that takes `edge_factor` times as long as this processor; the server is this processor."""
        time_ms = edge_factor * sum(self.edge_ms.values()) + sum(self.server_ms.values())
        return Cut((self.bytes + self.imu_bytes) * 8e-3, time_ms)


@dataclass(frozen=True, slots=True)
class Partition:
    """One recording. native_bytes, laz_bytes: a scan as the sensor's packets, as LAZ at 1 cm; None: not known.

    ros_bytes: of Cases 2 and 3 as ROS serialises LIO-SAM's messages. edge_max_ms: the slowest scan of ours.
    """

    name: str
    scans: int
    recording_s: float
    points: float
    native_bytes: float | None
    laz_bytes: float | None
    cases: dict[str, Case]
    ros_bytes: dict[str, float]
    edge_max_ms: float

    def mbps(self, bytes_per_scan: float) -> float:
        """By recording time."""
        return bytes_per_scan * self.scans * 8e-6 / self.recording_s

    def total_mbps(self, case: str) -> float:
        """Points and IMU."""
        return self.mbps(self.cases[case].bytes + self.cases[case].imu_bytes)

    def ratio(self, case: str, to_bytes: float | None) -> float | None:
        """How many times less than `to_bytes` a scan the case sends."""
        made = self.cases[case]
        return None if to_bytes is None else to_bytes / (made.bytes + made.imu_bytes)

    @property
    def case1_bytes(self) -> float:
        """Points and IMU a scan."""
        return self.cases["case1"].bytes + self.cases["case1"].imu_bytes

    def break_even_mbps(self, case: str, edge_factor: float) -> float:
        """Against Case 1."""
        return break_even_mbps(self.cases["case1"].cut(edge_factor), self.cases[case].cut(edge_factor))


def as_dict(found: list[Partition], laz_missing: bool) -> dict[str, Any]:
    """partition.json: docs/benchmarks.md says what its keys mean."""
    return {
        "check_break_even_mbps": paper.check(),
        "paper": {
            "table_3_mbps": {case: {"points": p, "imu": i, "total": p + i} for case, (p, i) in paper.TABLE_3.items()},
            "table_4": {name: {"case3_mbps": m, "of_case1": share} for name, (m, share) in paper.TABLE_4.items()},
            "break_even_mbps": paper.BREAK_EVEN_MBPS,
        },
        "a53_factor_assumed": A53_FACTOR,
        "laz": None if laz_missing else "1 cm, every scan, points only, ring by ring",
        "recordings": [_recording(one) for one in found],
    }


def _recording(one: Partition) -> dict[str, Any]:
    return {
        "name": one.name,
        "scans": one.scans,
        "recording_s": one.recording_s,
        "points_per_scan": one.points,
        "native_mbps": None if one.native_bytes is None else one.mbps(one.native_bytes),
        "laz_mbps": None if one.laz_bytes is None else one.mbps(one.laz_bytes),
        "laz_bits_per_point": None if one.laz_bytes is None else one.laz_bytes * 8 / one.points,
        "cases": {name: _case(one, name) for name in CASES},
        "edge_max_ms": one.edge_max_ms,
        "figure_12": {
            "bandwidth_mbps": BANDWIDTHS_MBPS.tolist(),
            "measured_ms": {name: total_ms(one.cases[name].cut(), BANDWIDTHS_MBPS).tolist() for name in CASES},
            "predicted_a53_ms": {
                name: total_ms(one.cases[name].cut(A53_FACTOR), BANDWIDTHS_MBPS).tolist() for name in CASES
            },
        },
    }


def _case(one: Partition, name: str) -> dict[str, Any]:
    case = one.cases[name]
    return {
        "points_per_scan": case.points,
        "bytes_per_scan": case.bytes + case.imu_bytes,
        "points_mbps": one.mbps(case.bytes),
        "imu_mbps": one.mbps(case.imu_bytes),
        "total_mbps": one.total_mbps(name),
        "ratio_to_case1": one.ratio(name, one.case1_bytes),
        "of_case1": (case.bytes + case.imu_bytes) / one.case1_bytes,
        "ratio_to_native": one.ratio(name, one.native_bytes),
        "ratio_to_laz": one.ratio(name, one.laz_bytes),
        "ros_mbps": one.mbps(one.ros_bytes[name]) if name in one.ros_bytes else None,
        "edge_ms": case.edge_ms,
        "server_ms": case.server_ms,
        "break_even_mbps": None if name == "case1" else in_words(one.break_even_mbps(name, 1.0)),
        "break_even_a53_mbps": None if name == "case1" else in_words(one.break_even_mbps(name, A53_FACTOR)),
    }
