"""What the edge's times come to: by scan, in software and with the cores, here and as predicted for the board."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitslam.bench import paper
from splitslam.bench.paper import A53_FACTOR

Array = NDArray[np.float64]
STAGES = ("motion", "deskew", "features", "encode")
SCAN_MS = 1e3 / paper.SCAN_HZ
# Bars: the LiDAR -> the edge's mean on this processor, and the processor's share with the cores, ms.
BARS_MS = {"64x2048": (12.0, 6.0)}


@dataclass(frozen=True, slots=True)
class Stats:
    """Of a series of scans, ms. over: share of scans over a scan's 100 ms."""

    mean: float
    std: float
    p99: float
    max: float
    over: float

    @classmethod
    def of(cls, ms: Array) -> Stats:
        """ms: (N,), at least one."""
        return cls(*map(float, (ms.mean(), ms.std(), np.percentile(ms, 99), ms.max(), (ms > SCAN_MS).mean())))


@dataclass(frozen=True, slots=True, eq=False)
class Accelerated:
    """The same scans with the cores, (N,) each, ms.

    ps_ms: stage -> CPU time of what stays on the processor, measured here; total too. cores_ms: RTL clocks at the
    board's clock, with the start of the DMA. image_board_ms: the Image node on the board, predicted from both.
    """

    ps_ms: dict[str, Array]
    cores_ms: Array
    image_board_ms: Array

    @property
    def deskew_ms(self) -> Array:
        """The Image node, this processor's share and the cores one after the other."""
        return self.ps_ms["deskew"] + self.cores_ms

    @property
    def total_ms(self) -> Array:
        """The whole edge, likewise."""
        return self.ps_ms["total"] + self.cores_ms

    @property
    def total_board_ms(self) -> Array:
        """The whole edge on the board: what is not the Image node's takes A53_FACTOR times as long as here."""
        return A53_FACTOR * (self.ps_ms["total"] - self.ps_ms["deskew"]) + self.image_board_ms


@dataclass(frozen=True, slots=True, eq=False)
class EdgeTimes:
    """One recording. points: mean a scan. cpu_ms: stage -> (N,) CPU time in software here, total too.

    lidar: rings x columns. accelerated: None where the cores were not asked, or cannot hold the sensor.
    """

    name: str
    lidar: str
    points: float
    cpu_ms: dict[str, Array]
    accelerated: Accelerated | None = None

    @property
    def scans(self) -> int:
        """How many were timed."""
        return len(self.cpu_ms["total"])

    def series(self) -> dict[str, dict[str, Array | None]]:
        """`deskew` (Table V) and `edge` (Table VI) -> by where and how: (N,) ms."""
        fast = self.accelerated
        deskew, total = self.cpu_ms["deskew"], self.cpu_ms["total"]
        return {
            "deskew": {
                "here": deskew,
                "here_fpga": None if fast is None else fast.deskew_ms,
                "a53": A53_FACTOR * deskew,
                "a53_fpga": None if fast is None else fast.image_board_ms,
            },
            "edge": {
                "here": total,
                "here_fpga": None if fast is None else fast.total_ms,
                "a53": A53_FACTOR * total,
                "a53_fpga": None if fast is None else fast.total_board_ms,
            },
        }

    def bars(self) -> dict[str, dict[str, Any]]:
        """What is asked of such a LiDAR beside what was seen, ms; met is None where it was not measured."""
        if self.lidar not in BARS_MS:
            return {}
        seen = {"cpu_mean_ms": float(self.cpu_ms["total"].mean()), "ps_mean_ms": None}
        if self.accelerated is not None:
            seen["ps_mean_ms"] = float(self.accelerated.ps_ms["total"].mean())
        return {
            name: {"seen": value, "bar": bar, "met": None if value is None else value <= bar}
            for (name, value), bar in zip(seen.items(), BARS_MS[self.lidar], strict=True)
        }


def as_dict(found: list[EdgeTimes], fpga: str) -> dict[str, Any]:
    """edge.json: docs/benchmarks.md says what its keys mean. fpga: how its times came about, or why there are none."""
    return {
        "a53_factor_assumed": A53_FACTOR,
        "a53": "predicted, not measured",
        "with_fpga": fpga,
        "paper": {
            "table_5_ms": {
                name: dict(zip(("mean", "std", "max", "with_fpga"), row, strict=True))
                for name, row in paper.TABLE_5.items()
            },
            "table_6_ms": {
                name: dict(zip(("mean", "mean_fpga", "max", "max_fpga"), row, strict=True))
                for name, row in paper.TABLE_6.items()
            },
        },
        "recordings": [_recording(one) for one in found],
    }


def _recording(one: EdgeTimes) -> dict[str, Any]:
    series = one.series()
    fast = one.accelerated
    return {
        "name": one.name,
        "lidar": one.lidar,
        "scans": one.scans,
        "points_per_scan": one.points,
        "stages_cpu_ms": {stage: asdict(Stats.of(one.cpu_ms[stage])) for stage in STAGES},
        "stages_ps_ms": None if fast is None else {stage: asdict(Stats.of(fast.ps_ms[stage])) for stage in STAGES},
        "cores_ms": None if fast is None else asdict(Stats.of(fast.cores_ms)),
        "ps_ms": None if fast is None else asdict(Stats.of(fast.ps_ms["total"])),
        **{
            f"{what}_ms": {how: None if ms is None else asdict(Stats.of(ms)) for how, ms in by.items()}
            for what, by in series.items()
        },
        "bars": one.bars(),
        "figure_10_ms": {how: None if ms is None else ms.round(4).tolist() for how, ms in series["edge"].items()},
    }
