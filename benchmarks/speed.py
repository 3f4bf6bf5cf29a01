"""CPU time a scan beside the peers', on one core and in turns: `python -m benchmarks.speed --help`.

Every run of a peer lies between two of ours, and what is told is the ratio: whatever else the machine does, and
however fast it is, meets both. Ours is `splitslam run` as it is installed, the CPU time of both processes from the
first scan to the last answer: Imu node, gRPC, compression, store, GNSS, loop pool. A peer's is the CPU time of its
process inside its own calls: odometry in memory, nothing else. Not counted, of either: start-up, reading the file,
decoding packets, and making the arrays or messages that a system takes; of ours this is `reader`.
"""

from __future__ import annotations

import json
import os
import platform
import sys
import tempfile
from pathlib import Path
from typing import Annotated, Any

import typer

if __package__ in (None, ""):  # run as a file
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks import speed_figures as figures
from benchmarks.command import listed, run
from benchmarks.drives import DRIVES, Case, Files, prepare
from benchmarks.dump import write_dump
from benchmarks.ours import run_ours
from benchmarks.peers import PEERS, check_peers_installed, run_peer
from benchmarks.speed_figures import OurCost, Turn
from splitslam.errors import InputError

_WARM_UP_SCANS = 20  # kernels read from their cache, files from the disk's

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command()
def speed(
    drive: Annotated[str, typer.Argument(metavar="DRIVE", help=f"Of {', '.join(DRIVES)}.")] = "yard1",
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where speed.json goes.")] = Path("out/speed"),
    peers: Annotated[str, typer.Option(metavar="LIST", help=f"Of {', '.join(PEERS)}; `none` for ours alone.")] = "",
    rounds: Annotated[int, typer.Option(metavar="N", min=1, help="Turns of each peer.")] = 3,
    max_scans: Annotated[int | None, typer.Option(metavar="N", min=2, help="Read only so many scans.")] = None,
    core: Annotated[int | None, typer.Option(metavar="N", help="Which core; default: the last one.")] = None,
    check: Annotated[bool, typer.Option("--check", help="Exit code 1 when a bar is missed.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print speed.json.")] = False,
) -> None:
    """Ours and the peers in turns on one recording; prints two tables in Markdown."""
    (name,) = listed("DRIVE", drive, tuple(DRIVES)) or ["yard1"]
    chosen = [] if peers == "none" else listed("--peers", peers, PEERS) or list(PEERS)
    if chosen:
        check_peers_installed()
    core = _pin(core)
    with tempfile.TemporaryDirectory(prefix="speed-") as work:
        files = prepare(Case(DRIVES[name]), Path(work), None)
        load_before = os.getloadavg()[0]
        runs, turns = _in_turns(files, Path(work), chosen, rounds, max_scans)
    found = {
        "drive": name,
        "max_scans": max_scans,
        "rounds": rounds,
        "machine": _machine(core, load_before),
        "ours": figures.ours_dict(runs),
        "peers": figures.compared(turns),
    }
    out.mkdir(parents=True, exist_ok=True)
    text = json.dumps(found, indent=1, allow_nan=False)
    (out / "speed.json").write_text(text + "\n", encoding="utf-8")
    if as_json:
        print(text)
    else:
        print(f"\n### {name}: ours\n\n{figures.ours_table(runs)}")
        print(f"\n### {name}: beside ours\n\n{figures.peers_table(turns)}\n\n{_said(found['machine'])}")
    if check and any(peer["met"] is False for peer in found["peers"].values()):
        raise typer.Exit(1)


def _in_turns(
    files: Files, work: Path, chosen: list[str], rounds: int, max_scans: int | None
) -> tuple[list[OurCost], list[Turn]]:
    """ours, peer, ours, peer, ..., ours; all inputs made before the first of them."""
    dump = work / "dump"
    if chosen:
        write_dump(files.bag, files.robot, dump, max_scans=max_scans)
    _ours(files, work, _WARM_UP_SCANS)
    runs, turns = [_ours(files, work, max_scans)], []
    for peer in chosen * rounds or ["none"] * (rounds - 1):
        found = None if peer == "none" else run_peer(peer, dump, work)
        runs.append(_ours(files, work, max_scans))
        if found is None:
            continue
        if found.cpu_ms is None or found.prepare_ms is None:
            print(f"{peer}: {found.ended}", file=sys.stderr, flush=True)
            continue
        turns.append(Turn(peer, found.cpu_ms, found.prepare_ms, *runs[-2:]))
        print(f"{peer}: {found.cpu_ms:.1f} ms, {turns[-1].ratio:.2f} times ours", file=sys.stderr, flush=True)
    return runs, turns


def _ours(files: Files, work: Path, max_scans: int | None) -> OurCost:
    made = run_ours(files, work / "ours", disable=(), deskew="cpu", max_scans=max_scans)
    if made.ended:
        raise InputError(f"splitslam run {files.bag.name}: {made.ended}")
    cost, load = OurCost.of(made.report), os.getloadavg()[0]
    print(f"ours: edge {cost.edge:.2f} + map {cost.map:.2f} ms, load {load:.1f}", file=sys.stderr, flush=True)
    return cost


def _pin(core: int | None) -> int:
    """This process and all that it starts, to one core."""
    allowed = os.sched_getaffinity(0)
    core = max(allowed) if core is None else core
    if core not in allowed:
        raise InputError(f"--core: expected one of {', '.join(map(str, sorted(allowed)))}, found {core}")
    os.sched_setaffinity(0, {core})
    return core


def _machine(core: int, load_before: float) -> dict[str, Any]:
    models = [line.split(":", 1)[1].strip() for line in _cpu_info() if line.startswith("model name")]
    return {
        "processor": models[0] if models else platform.machine(),
        "cores": os.cpu_count(),
        "pinned_to": core,
        "python": platform.python_version(),
        "load_before": load_before,
        "load_after": os.getloadavg()[0],
    }


def _cpu_info() -> list[str]:
    try:
        return Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return []


def _said(machine: dict[str, Any]) -> str:
    return (
        f"Everything on core {machine['pinned_to']} of {machine['cores']} ({machine['processor']}); load average "
        f"{machine['load_before']:.1f} before, {machine['load_after']:.1f} after. Bars: medians."
    )


if __name__ == "__main__":
    run(app)
