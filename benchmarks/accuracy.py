"""Trajectory errors beside the peers', and what goes with them: `python -m benchmarks.accuracy --help`.

Peers run once in odometry (they have neither loops nor GNSS here), with seed 1; ours with every noise seed. Cells that
are in the output folder already are not computed again, so an interrupted run goes on where it was; after a change of
the code delete the folder, or the cells of ours in it.
"""

from __future__ import annotations

import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Annotated

import typer

if __package__ in (None, ""):  # run as a file
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks import tables
from benchmarks.cells import OURS, SHARPNESS, Limits, Store, compute
from benchmarks.command import listed, run
from benchmarks.drives import CLEAN, DRIVES, FAULTS, MADE, RECORDED, Case
from benchmarks.peers import PEERS, check_peers_installed

TABLES = ("odometry", "full", "deskew", "sharpness", "sweep")
_DESKEW_ON = ("yard1", "campus", "street")
_SWEEP_ON = ("campus", "street")
_NOT_SWEPT = "wheel-slip"  # these drives have no wheel odometry
_QUICK = Limits(seconds=12.0, max_scans=120)
Plan = dict[Case, list[str]]

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command()
def accuracy(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where the cells are kept.")] = Path("out/accuracy"),
    only: Annotated[str, typer.Option(metavar="LIST", help=f"Tables, of {', '.join(TABLES)}.")] = "",
    systems: Annotated[str, typer.Option(metavar="LIST", help=f"Of ours, {', '.join(PEERS)}.")] = "",
    drives: Annotated[str, typer.Option(metavar="LIST", help=f"Of {', '.join(DRIVES)}.")] = "",
    seeds: Annotated[int, typer.Option(metavar="N", min=1, help="Noise seeds of a made drive, ours.")] = 5,
    sweep: Annotated[bool, typer.Option("--sweep", help="One perturbation at a time, ours only.")] = False,
    quick: Annotated[bool, typer.Option("--quick", help="12 s of each drive, one seed: does everything run?")] = False,
    jobs: Annotated[int, typer.Option(metavar="N", min=1, help="Recordings at a time.")] = 2,
    show: Annotated[bool, typer.Option("--show", help="Print what is there, compute nothing.")] = False,
) -> None:
    """Compute what is missing and print the tables in Markdown."""
    wanted = listed("--only", only, TABLES) or (["sweep"] if sweep else list(TABLES[:-1]))
    chosen = listed("--systems", systems, ("ours", *PEERS)) or ["ours", *PEERS]
    names = listed("--drives", drives, tuple(DRIVES))
    store = Store(out)
    comparison = _comparison_cases(names or [drive.name for drive in (*RECORDED, *MADE)], 1 if quick else seeds)
    swept = _sweep_cases(names or list(_SWEEP_ON)) if "sweep" in wanted else []
    plan = _plan(wanted, chosen, comparison, bool(names)) | {case: ["ours"] for case in swept}
    if not show:
        if any(system in PEERS for cells in plan.values() for system in cells):
            check_peers_installed()
        _compute(plan, store, _QUICK if quick else Limits(), jobs)
    _print(wanted, store, comparison, plan, swept)


def _comparison_cases(names: list[str], seeds: int) -> dict[Case, list[Case]]:
    """The first seed's case -> the cases of all seeds. Recordings are what they are; made drives have two settings."""
    cases = {}
    for drive in (DRIVES[name] for name in names):
        for perturb in (CLEAN,) if drive.recorded else (CLEAN, FAULTS):
            numbers = (1,) if drive.recorded else range(1, seeds + 1)
            every = [Case(drive, perturb, seed) for seed in numbers]
            cases[every[0]] = every
    return cases


def _sweep_cases(names: list[str]) -> list[Case]:
    from splitslam.sim.faults import SWEEP

    made = [DRIVES[name] for name in names if DRIVES[name].recorded is None]
    settings = [CLEAN, *(setting for setting in SWEEP if not setting.startswith(_NOT_SWEPT))]
    return [Case(drive, perturb) for drive in made for perturb in settings]


def _plan(wanted: list[str], chosen: list[str], cases: dict[Case, list[Case]], named: bool) -> Plan:
    """Which systems each case needs, in the order in which they are run."""
    plan: Plan = {}
    for first, seeds in cases.items():
        for case in seeds:
            cells: list[str] = []
            if "ours" in chosen:
                cells += ["ours_odometry"] if {"odometry", "deskew", "sharpness"} & set(wanted) else []
                cells += ["ours"] if "full" in wanted else []
            if case == first:
                peers = [peer for peer in PEERS if peer in chosen]
                cells += peers if {"odometry", "full"} & set(wanted) else []
                if "deskew" in wanted and "ours" in chosen and case.perturb == CLEAN and _deskewed(case, named):
                    cells += ["deskew_off", "deskew_rotation"]
                if "sharpness" in wanted and {"ours", "kiss_icp"} <= set(chosen) and not case.drive.exact:
                    cells += [name for name in ("kiss_icp", SHARPNESS) if name not in cells]
            plan[case] = cells
    return plan


def _deskewed(case: Case, named: bool) -> bool:
    return named or case.drive.name in _DESKEW_ON


def _compute(plan: Plan, store: Store, limits: Limits, jobs: int) -> None:
    def one(case: Case) -> None:
        missing = [system for system in plan[case] if store.get(case, system) is None]
        if missing:
            compute(case, missing, store, limits, lambda line: print(line, file=sys.stderr, flush=True))

    # The peers' cases are the longest: they come first, so that no core idles at the end.
    order = sorted(plan, key=lambda case: -sum(1 if system in OURS else 3 for system in plan[case]))
    with ThreadPoolExecutor(jobs) as pool:
        for done in [pool.submit(one, case) for case in order]:
            done.result()


def _print(wanted: list[str], store: Store, cases: dict[Case, list[Case]], plan: Plan, swept: list[Case]) -> None:
    for table, system in (("odometry", "ours_odometry"), ("full", "ours")):
        if table in wanted:
            name = "Odometry only (`--disable loops,gnss`)" if table == "odometry" else "Full system"
            print(f"\n### {name}: ATE, cm\n\n{tables.comparison(store, cases, system)}")
            print(f"\n### {name}: details, cm\n\n{tables.details(store, cases, system)}")
    if {"odometry", "full"} & set(wanted):
        title = "The peers: RPE 1 s, cm / largest, cm / missing / stamp offset"
        print(f"\n### {title}\n\n{tables.peer_details(store, cases)}")
    if "deskew" in wanted:
        shown = {case: seeds for case, seeds in cases.items() if "deskew_off" in plan[case]}
        print(f"\n### Deskew, odometry only, cm\n\n{tables.deskew(store, shown)}")
    if "sharpness" in wanted:
        shown = [case for case in cases if SHARPNESS in plan[case]]
        print(f"\n### Map sharpness: mean thickness of planes\n\n{tables.sharp(store, shown)}")
    if "sweep" in wanted:
        print(f"\n### One perturbation at a time, full system, cm\n\n{tables.sweep(store, swept)}")


if __name__ == "__main__":
    run(app)
