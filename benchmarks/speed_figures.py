"""What `benchmarks/speed.py` finds out: CPU times of runs in turns, ratios, and whether the bars are met."""

from __future__ import annotations

import statistics
from dataclasses import dataclass
from typing import Any

from benchmarks.tables import TITLES, markdown
from splitslam.bench.paper import A53_FACTOR

# How many times our CPU time a scan a peer must take.
BARS = {"lio_sam": 7.0, "dlio": 2.5}
_SIDES = {"edge": ("motion", "deskew", "features", "encode", "total"), "map": ("registration", "graph", "total")}


@dataclass(frozen=True, slots=True)
class Spread:
    """Of some runs."""

    median: float
    least: float
    most: float

    @classmethod
    def of(cls, values: list[float]) -> Spread:
        """At least one value."""
        return cls(statistics.median(values), min(values), max(values))

    def __str__(self) -> str:
        return f"{self.median:.2f} ({self.least:.2f} to {self.most:.2f})"

    def as_dict(self) -> dict[str, float]:
        """For JSON."""
        return {"median": self.median, "min": self.least, "max": self.most}


@dataclass(frozen=True, slots=True)
class OurCost:
    """A run of ours, ms of CPU a scan. edge, map: whole processes. reader: of the edge's, not in `edge`.

    stages: side -> stage -> {mean, p99, ...} of the thread that does it, a part of `edge` or `map`.
    """

    edge: float
    map: float
    reader: float
    stages: dict[str, dict[str, dict[str, float]]]

    @classmethod
    def of(cls, report: dict[str, Any]) -> OurCost:
        """From report.json."""
        cpu_ms = report["cpu_ms_per_scan"]
        stages = {side: {name: report[f"{side}_ms"][name] for name in names} for side, names in _SIDES.items()}
        return cls(cpu_ms["edge"], cpu_ms["map"], cpu_ms["reader"], stages)

    @property
    def both(self) -> float:
        """What a peer is held against."""
        return self.edge + self.map


@dataclass(frozen=True, slots=True)
class Turn:
    """A run of a peer between two of ours. cpu_ms, prepare_ms: see benchmarks.peers.PeerRun."""

    peer: str
    cpu_ms: float
    prepare_ms: float
    before: OurCost
    after: OurCost

    @property
    def ratio(self) -> float:
        """How many times ours, which is the mean of the run before and the run after: what drifts falls out."""
        return self.cpu_ms / (0.5 * (self.before.both + self.after.both))


def verdict(peer: str, ratio: Spread) -> bool | None:
    """Whether the bar is met in the median; None: there is no bar."""
    return None if peer not in BARS else ratio.median >= BARS[peer]


def compared(turns: list[Turn]) -> dict[str, dict[str, Any]]:
    """By peer: cpu_ms, prepare_ms and ratio, each with its spread; ratios of all turns, bar, met."""
    out: dict[str, dict[str, Any]] = {}
    for peer in dict.fromkeys(turn.peer for turn in turns):
        own = [turn for turn in turns if turn.peer == peer]
        ratio = Spread.of([turn.ratio for turn in own])
        out[peer] = {
            "cpu_ms": Spread.of([turn.cpu_ms for turn in own]).as_dict(),
            "prepare_ms": Spread.of([turn.prepare_ms for turn in own]).as_dict(),
            "ratio": ratio.as_dict(),
            "ratios": [turn.ratio for turn in own],
            "bar": BARS.get(peer),
            "met": verdict(peer, ratio),
        }
    return out


def ours_dict(runs: list[OurCost]) -> dict[str, Any]:
    """Of all runs: edge, map, both, reader; stages: medians of mean and p99; outside: what no stage's thread did."""
    return {
        "runs": len(runs),
        "cpu_ms": {
            name: Spread.of([getattr(run, name) for run in runs]).as_dict()
            for name in ("edge", "map", "both", "reader")
        },
        "stages_ms": {
            side: {
                name: {key: statistics.median(run.stages[side][name][key] for run in runs) for key in ("mean", "p99")}
                for name in names
            }
            for side, names in _SIDES.items()
        },
        "outside_ms": {
            side: Spread.of([getattr(run, side) - run.stages[side]["total"]["mean"] for run in runs]).as_dict()
            for side in _SIDES
        },
    }


def peers_table(turns: list[Turn]) -> str:
    """Markdown: each peer beside ours."""
    header = ("system", "CPU ms a scan: median (range)", "its input, ms", "times ours: median (range)", "bar", "met")
    rows = []
    for peer, found in compared(turns).items():
        own = [turn for turn in turns if turn.peer == peer]
        bar, met = (f">= {found['bar']:g}", "yes" if found["met"] else "**no**") if found["bar"] else ("-", "-")
        cpu_ms, ratio = (Spread.of([getattr(turn, key) for turn in own]) for key in ("cpu_ms", "ratio"))
        rows.append((TITLES[peer], str(cpu_ms), f"{found['prepare_ms']['median']:.2f}", str(ratio), bar, met))
    return markdown(header, rows)


def ours_table(runs: list[OurCost]) -> str:
    """Markdown: where our time goes; of the edge also what an A53 would take, which is predicted."""
    found = ours_dict(runs)
    rows = []
    for side, stages in found["stages_ms"].items():
        predicted = _predicted if side == "edge" else _not_on_the_robot
        for name, ms in stages.items():
            label = "all stages" if name == "total" else name
            rows.append((f"{side}: {label}", f"{ms['mean']:.2f}", f"{ms['p99']:.2f}", predicted(ms["mean"])))
        for label, cost in (("rest of the process", found["outside_ms"][side]), ("process", found["cpu_ms"][side])):
            label = f"**{side}: {label}**" if label == "process" else f"{side}: {label}"
            rows.append((label, str(Spread(*cost.values())), "-", predicted(cost["median"])))
    rows.append(("**both, held against the peers**", str(Spread(*found["cpu_ms"]["both"].values())), "-", "-"))
    reader = found["cpu_ms"]["reader"]
    rows.append(("reader, not counted", str(Spread(*reader.values())), "-", _predicted(reader["median"])))
    return markdown(("SplitSLAM", "CPU ms a scan, median (range)", "p99", "A53: predicted, not measured"), rows)


def _predicted(ms: float) -> str:
    return f"{A53_FACTOR * ms:.1f}"


def _not_on_the_robot(_: float) -> str:
    return "-"
