"""Drives and sensors of kinds that the defaults were not made with: `python -m benchmarks.unseen --help`.

Odometry only, the defaults of `splitslam run`, made recordings without GNSS. Cells that are in the output folder are
not computed again; after a change of the code give another.
"""

from __future__ import annotations

import json
import sys
import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

if __package__ in (None, ""):  # run as a file
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks import scoring
from benchmarks.command import listed, run
from benchmarks.consistency import consistency
from benchmarks.drives import Files
from benchmarks.dump import scan_stamps_ns
from benchmarks.ours import run_ours
from benchmarks.unseen_drives import UNSEEN, Unseen
from splitslam.sim import simulate
from splitslam.sim.recorder import simulate_grid
from splitslam.tum import read_tum

_TRACKING = "tracking"

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command()
def unseen(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where the cells are kept.")] = Path("out/unseen"),
    drives: Annotated[str, typer.Option(metavar="LIST", help=f"Of {', '.join(UNSEEN)}.")] = "",
    max_scans: Annotated[int | None, typer.Option(metavar="N", min=20, help="Only the first N scans.")] = None,
    show: Annotated[bool, typer.Option("--show", help="Print what is there, compute nothing.")] = False,
) -> None:
    """Compute what is missing and print the table in Markdown."""
    cases = [UNSEEN[name] for name in listed("--drives", drives, tuple(UNSEEN)) or UNSEEN]
    out.mkdir(parents=True, exist_ok=True)
    cells: list[tuple[Unseen, dict[str, Any]]] = []
    for case in cases:
        path = out / f"{case.name}.json"
        if not path.exists() and not show:
            path.write_text(json.dumps(_cell(case, max_scans), indent=1) + "\n")
            print(_row(case, json.loads(path.read_text())), file=sys.stderr, flush=True)
        if path.exists():
            cells.append((case, json.loads(path.read_text())))
    print("| | drive | ATE, as answered / final | largest | NEES | not tracking | uplink | mapped, dropped |")
    print("|---|---|---|---|---|---|---|---|")
    print("\n".join(_row(*each) for each in cells))


def _cell(case: Unseen, max_scans: int | None) -> dict[str, Any]:
    """Makes the recording, runs it, scores it."""
    with tempfile.TemporaryDirectory(prefix="splitslam-unseen-") as folder:
        files = _recorded(case, Path(folder))
        disable = ("loops", "gnss") if case.imu else ("loops", "gnss", "imu")
        ours = run_ours(files, Path(folder) / "run", disable=disable, deskew="auto", max_scans=max_scans)
        if ours.trajectory is None or ours.online is None or ours.doubt is None:
            return {"ended": ours.ended}
        truth, stamps_ns = read_tum(files.truth), scan_stamps_ns(files.bag, files.robot, max_scans=max_scans)
        doubt = consistency(ours.online, ours.doubt.covariances, truth)
        return {
            "final": scoring.score(ours.trajectory, truth, stamps_ns, search=False).as_dict(),
            "online": scoring.score(ours.online, truth, stamps_ns, search=False).as_dict(),
            "states": ours.doubt.state_shares,
            "nees": None if doubt is None else asdict(doubt),
            **{key: ours.report[key] for key in ("scans", "uplink", "jumps")},
            "ended": "",
        }


def _recorded(case: Unseen, folder: Path) -> Files:
    if case.grid is None:
        made = simulate(case.spec, folder)
        return Files(made.bag_path, made.robot_path, made.imu_truth_path)
    bag, robot = simulate_grid(case.spec, case.grid, folder)
    return Files(bag, robot, folder / f"{case.spec.name}.imu_truth.tum")


def _row(case: Unseen, cell: dict[str, Any]) -> str:
    if cell["ended"]:
        return f"| `{case.name}` | {case.what} | {cell['ended']} | | | | | |"
    final, online, scans = cell["final"], cell["online"], cell["scans"]
    errors = f"{_mm(online['ate_m'])} / {_mm(final['ate_m'])}"
    nees = "-" if cell["nees"] is None else f"{cell['nees']['mean']:.2g}"
    others = {state: share for state, share in cell["states"].items() if state.lower() != _TRACKING}
    states = ", ".join(f"{share:.0%} {state}" for state, share in others.items() if share > 0.005)
    kept = f"{scans['mapped']} of {scans['read']}, {scans['dropped']}"
    return (
        f"| `{case.name}` | {case.what} | {errors} | {_mm(final['max_m'])} | {nees} | {states or 'never'} "
        f"| {cell['uplink']['kbps']:.0f} kbit/s | {kept} |"
    )


def _mm(metres: float | None) -> str:
    if metres is None:
        return "-"
    return f"{metres:.1f} m" if metres >= 1.0 else f"{1e3 * metres:.1f} mm"


if __name__ == "__main__":
    run(app)
