"""Trajectory error against uplink rate: `python -m benchmarks.rate_distortion --help`.

Three ways to send a scan from the same edge to the same map pipeline, each at several rates. Odometry only, so that
neither loops nor GNSS mend what the wire has spoilt. Cells that are in the output folder are not computed again.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated

import typer

if __package__ in (None, ""):  # run as a file
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks import scoring
from benchmarks.cells import Cell, Store
from benchmarks.command import listed, run
from benchmarks.drives import DRIVES, Case, Files, prepare
from benchmarks.rate_picture import draw, table
from benchmarks.wires import LioSamZstd, Ours, ThinnedDraco, Wire
from edge_agent.settings import FeatureSettings
from splitslam.bench.in_one_process import TimedEvent, run_both
from splitslam.scan import Scan
from splitslam.tum import read_tum

DEFAULT_DRIVES = "yard1,campus"
DEFAULT = "default"  # the level of ours without a budget
# system -> level -> what goes over the wire; how a system is told to send less stands here and nowhere else.
SYSTEMS: dict[str, dict[str, Callable[[], Wire]]] = {
    "ours": {
        **{f"{kbps} kbit/s": lambda kbps=kbps: Ours(kbps) for kbps in (40, 70, 120)},
        DEFAULT: lambda: Ours(),
        "twice the points": lambda: Ours(None, FeatureSettings(sparse_corners=400, sparse_surfs=1600)),
        **{f"every {n}th scan": lambda n=n: Ours(None, dense_m=0.0, every=n) for n in (8, 4)},
        "all dense": lambda: Ours(None, dense_m=0.0),
    },
    "lio_sam_zstd": {
        "2, 2.4 m": lambda: LioSamZstd(2, 2.4),
        "5, 1.6 m": lambda: LioSamZstd(5, 1.6),
        "every 8th scan": lambda: LioSamZstd(every=8),
        "every 4th scan": lambda: LioSamZstd(every=4),
        "every 2nd scan": lambda: LioSamZstd(every=2),
        "10, 0.8 m": lambda: LioSamZstd(10, 0.8),
        "20, 0.4 m": lambda: LioSamZstd(),
    },
    "draco": {
        "2 m": lambda: ThinnedDraco(2.0),
        "1.2 m": lambda: ThinnedDraco(1.2),
        "every 8th scan": lambda: ThinnedDraco(0.5, every=8),
        "every 4th scan": lambda: ThinnedDraco(0.5, every=4),
        "0.8 m": lambda: ThinnedDraco(0.8),
        "0.5 m": lambda: ThinnedDraco(0.5),
    },
}

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command()
def rate_distortion(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where the cells are kept.")] = Path("out/rate_distortion"),
    drives: Annotated[str, typer.Option(metavar="LIST", help=f"Of {', '.join(DRIVES)}.")] = DEFAULT_DRIVES,
    systems: Annotated[str, typer.Option(metavar="LIST", help=f"Of {', '.join(SYSTEMS)}.")] = ",".join(SYSTEMS),
    levels: Annotated[int, typer.Option(metavar="N", min=1, help="At most so many rates of a system.")] = 99,
    max_scans: Annotated[int | None, typer.Option(metavar="N", min=1, help="Only so many scans of each.")] = None,
    show: Annotated[bool, typer.Option("--show", help="Print and draw what is there, compute nothing.")] = False,
) -> None:
    """Compute what is missing, print the table in Markdown, draw rate_distortion.png into the output folder."""
    cases = [Case(DRIVES[name]) for name in listed("--drives", drives, tuple(DRIVES))]
    chosen = listed("--systems", systems, tuple(SYSTEMS))
    store = Store(out)
    for case in [] if show else cases:
        _compute(case, [(s, level) for s in chosen for level in _spread(list(SYSTEMS[s]), levels)], store, max_scans)
    found = {
        case: {s: [cell for level in SYSTEMS[s] if (cell := store.get(case, cell_name(s, level)))] for s in chosen}
        for case in cases
    }
    print(table(found))
    (out / "rate_distortion.png").write_bytes(draw(found, DEFAULT))


def _compute(case: Case, wanted: list[tuple[str, str]], store: Store, max_scans: int | None) -> None:
    missing = [(system, level) for system, level in wanted if store.get(case, cell_name(system, level)) is None]
    if not missing:
        return
    with tempfile.TemporaryDirectory(prefix="splitslam-rate-") as folder:
        files = prepare(case, Path(folder), None if max_scans is None else 0.1 * max_scans + 2.0)
        for system, level in missing:
            begun_s = time.monotonic()
            cell = one(files, SYSTEMS[system][level](), case.drive.disable, max_scans)
            store.put(case, cell_name(system, level), {"case": case.name, "system": system, "level": level, **cell})
            line = f"{case.name} {system} {level}: {cell['kbps']:.0f} kbit/s, ATE {cell['score']['ate_m']} m"
            print(f"{line} ({time.monotonic() - begun_s:.0f} s)", file=sys.stderr, flush=True)


def one(files: Files, wire: Wire, disable: tuple[str, ...] = (), max_scans: int | None = None) -> Cell:
    """One recording over one wire: rate, features a scan, scans without a pose, errors of the trajectory."""
    mapped = run_both(
        files.bag,
        files.robot,
        wire=wire,
        harm=lambda events: thinned(events, wire.every),
        max_scans=max_scans,
        disable=tuple(dict.fromkeys((*disable, "gnss"))),
        edge_settings=wire.settings,
        max_kbps=wire.max_kbps,
        deskew_again=wire.deskew_again,
    )
    trajectory = mapped.final()
    score = scoring.score(trajectory, read_tum(files.truth), trajectory.stamps_ns, search=False)
    scans = mapped.counts.scans_read // wire.every
    missing = scans - len(trajectory)
    return {
        "kbps": wire.sent.bytes * 8e-3 / mapped.recording_s,
        "points_per_scan": wire.sent.points / max(1, wire.sent.frames),
        "missing": missing,
        "score": {**score.as_dict(), "failed": score.failed or missing > scoring.MISSING_RATIO * scans},
    }


def thinned(events: Iterator[TimedEvent], every: int) -> Iterator[TimedEvent]:
    """Without the scans between each `every`th."""
    scans = 0
    for at_ns, event in events:
        if isinstance(event, Scan):
            scans += 1
            if scans % every:
                continue
        yield at_ns, event


def cell_name(system: str, level: str) -> str:
    """Of a cell's file."""
    return f"{system}.{level.replace(', ', '_').replace(' ', '_').replace('/', '')}"


def _spread(levels: list[str], most: int) -> list[str]:
    """At most `most` of them, evenly, the highest rate among them."""
    if len(levels) <= most:
        return levels
    return [levels[round((len(levels) - 1) * k / max(1, most - 1))] for k in range(most)] if most > 1 else levels[-1:]


if __name__ == "__main__":
    run(app)
