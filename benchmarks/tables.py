"""The cells as Markdown tables."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Iterable
from typing import Any

from benchmarks.cells import OURS, SHARPNESS, Cell, Store
from benchmarks.drives import CLEAN, FAULTS, Case, Drive
from benchmarks.peers import PEERS

TITLES = {
    "ours_odometry": "SplitSLAM",
    "ours": "SplitSLAM",
    "lio_sam": "LIO-SAM",
    "dlio": "DLIO",
    "kiss_icp": "KISS-ICP",
    "rko_lio": "rko_lio",
}
_SETTINGS = {CLEAN: "clean", FAULTS: "all faults"}
_NONE = "-"


def markdown(header: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """One table; columns after the first are numbers."""
    header = list(header)
    lines = [header, ["---", *["---:"] * (len(header) - 1)], *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def cm(value_m: float | None) -> str:
    """Metres -> centimetres with two or three digits."""
    if value_m is None:
        return _NONE
    value_cm = 100.0 * value_m
    return f"{value_cm:.2f}" if value_cm < 10 else f"{value_cm:.1f}" if value_cm < 100 else f"{value_cm:.0f}"


def ate(cell: Cell | None) -> str:
    """ATE of one run in cm; failures are marked."""
    if cell is None:
        return _NONE
    errors = cell["score"]
    if errors["ate_m"] is None:
        return "no poses"
    if errors["diverged"]:
        return f"diverged ({cm(errors['ate_m'])})"
    return cm(errors["ate_m"]) + (" (poses missing)" if errors["failed"] else "")


def spread(cells: list[Cell], pick: Callable[[Cell], float | None]) -> str:
    """Median and worst over the seeds, cm; a run without the figure is the worst there is."""
    if not cells:
        return _NONE
    values = [float("inf") if (value := pick(cell)) is None else value for cell in cells]
    median, worst = statistics.median(values), max(values)
    shown = [cm(value) if value < float("inf") else "failed" for value in (median, worst)]
    return shown[0] if len(cells) == 1 else f"{shown[0]} ({shown[1]})"


def best_peer(peers: Iterable[Cell | None]) -> float | None:
    """The smallest ATE of a peer that has not failed, m."""
    there = [cell["score"]["ate_m"] for cell in peers if cell is not None and not cell["score"]["failed"]]
    return min(there, default=None)


def comparison(store: Store, cases: dict[Case, list[Case]], system: str) -> str:
    """ATE of `system` (ours or ours_odometry) beside the peers. cases: the first seed's case -> all seeds' cases."""
    header = ["drive", "setting", "SplitSLAM: median (worst)", *(TITLES[peer] for peer in PEERS), "no worse than best"]
    rows = []
    for first, seeds in cases.items():
        ours = _cells(store, seeds, system)
        peers = [store.get(first, peer) for peer in PEERS]
        best_m, limit = best_peer(peers), "-"
        if ours and any(peers):
            median_m = statistics.median(_ate_m(cell) for cell in ours)
            limit = "yes" if median_m < float("inf") and (best_m is None or median_m <= best_m) else "**no**"
        rows.append([*_name(first), spread(ours, _working), *(ate(cell) for cell in peers), limit])
    return markdown(header, rows)


def details(store: Store, cases: dict[Case, list[Case]], system: str) -> str:
    """What else is known of our runs: median and worst over the seeds."""
    header = ["drive", "setting", "RPE 1 s", "largest", "online ATE", "missing", "odom step m", "deg", "NEES", "states"]
    rows = []
    for first, seeds in cases.items():
        cells = _cells(store, seeds, system)
        good = [cell for cell in cells if "jumps" in cell]
        nees = [cell["nees"]["mean"] for cell in good if cell.get("nees")]
        rows.append(
            [
                *_name(first),
                spread(cells, lambda cell: cell["score"]["rpe_1s_m"]),
                spread(cells, lambda cell: cell["score"]["max_m"]),
                spread(cells, lambda cell: cell.get("online", cell["score"])["ate_m"]),
                str(max((cell["score"]["missing"] for cell in cells), default=_NONE)),
                f"{max(cell['jumps']['odom_max_m'] for cell in good):.4f}" if good else _NONE,
                f"{max(cell['jumps']['odom_max_deg'] for cell in good):.3f}" if good else _NONE,
                f"{statistics.median(nees):.2f} ({max(nees):.2f})" if nees else _NONE,
                states(good),
            ]
        )
    return markdown(header, rows)


def peer_details(store: Store, cases: Iterable[Case]) -> str:
    """The peers' other figures: RPE over 1 s / largest error / missing poses / stamp offset."""
    header = ["drive", "setting", *(TITLES[peer] for peer in PEERS)]
    rows = [[*_name(case), *(_peer(store.get(case, peer)) for peer in PEERS)] for case in cases]
    return markdown(header, rows)


def deskew(store: Store, drives: dict[Case, list[Case]]) -> str:
    """ATE and RPE with and without deskew, odometry only."""
    systems = {"off": "deskew_off", "rotation": "deskew_rotation", "cpu": "ours_odometry"}
    header = ["drive", "setting", *(f"{name}: ATE / RPE 1 s" for name in systems)]
    rows = []
    for first in drives:
        cells = [store.get(first, system) for system in systems.values()]
        shown = [_NONE if cell is None else f"{ate(cell)} / {cm(cell['score']['rpe_1s_m'])}" for cell in cells]
        rows.append([*_name(first), *shown])
    return markdown(header, rows)


def sharp(store: Store, cases: Iterable[Case]) -> str:
    """Mean plane thickness with our trajectory, with KISS-ICP's, and with what the drive has as truth."""
    header = ["drive", "setting", "SplitSLAM, mm", "KISS-ICP, mm", "truth, mm", "planes"]
    rows = []
    for case in cases:
        cell = store.get(case, SHARPNESS)
        if cell is None or cell["ended"]:
            rows.append([*_name(case), _NONE, _NONE, _NONE, cell["ended"] if cell else _NONE])
        else:
            thickness = (f"{cell[system] * 1e3:.1f}" for system in ("ours_odometry", "kiss_icp", "truth"))
            rows.append([*_name(case), *thickness, str(cell["cells"])])
    return markdown(header, rows)


def sweep(store: Store, cases: Iterable[Case]) -> str:
    """One perturbation at a time: what it does to the trajectory, and whether the answers say so."""
    header = [
        "drive",
        "perturbation",
        "ATE",
        "RPE 1 s",
        "largest",
        "missing",
        "odom step m",
        "NEES",
        "states",
        "diverged",
    ]
    rows = []
    for case in cases:
        cell = store.get(case, "ours")
        if cell is None:
            continue
        errors, nees = cell["score"], cell.get("nees")
        rows.append(
            [
                case.drive.name,
                case.perturb,
                *(cm(errors[key]) for key in ("ate_m", "rpe_1s_m", "max_m")),
                str(errors["missing"]),
                f"{cell['jumps']['odom_max_m']:.4f}" if "jumps" in cell else _NONE,
                f"{nees['mean']:.2f}" if nees else _NONE,
                states([cell]),
                "**yes**" if errors["failed"] else "no",
            ]
        )
    return markdown(header, rows)


def states(cells: list[Cell]) -> str:
    """Share of degenerate and of lost answers, mean over the runs."""
    if not any("states" in cell for cell in cells):
        return _NONE
    shares = {
        name: statistics.fmean(cell.get("states", {}).get(name, 0.0) for cell in cells)
        for name in ("degenerate", "lost", "localising")
    }
    return ", ".join(f"{name} {share:.0%}" for name, share in shares.items() if share > 0) or "tracking"


def _cells(store: Store, cases: Iterable[Case], system: str) -> list[Cell]:
    assert system in OURS
    return [cell for case in cases if (cell := store.get(case, system)) is not None]


def _ate_m(cell: Cell) -> float:
    return float("inf") if cell["score"]["failed"] else float(cell["score"]["ate_m"])


def _working(cell: Cell) -> float | None:
    return None if cell["score"]["failed"] else cell["score"]["ate_m"]


def _peer(cell: Cell | None) -> str:
    if cell is None:
        return _NONE
    errors: dict[str, Any] = cell["score"]
    if errors["ate_m"] is None:
        return "no poses"
    lengths = " / ".join(cm(errors[key]) for key in ("rpe_1s_m", "max_m"))
    return f"{lengths} / {errors['missing']} / {errors['offset_ns'] / 1e6:+.0f} ms"


def _name(case: Case) -> tuple[str, str]:
    drive: Drive = case.drive
    return drive.name, _SETTINGS.get(case.perturb, case.perturb) if drive.recorded is None else "recorded"
