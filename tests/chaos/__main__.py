"""The long form, `make chaos`: every fault on one stack, then the soak. A table as it goes, JSON into out/chaos."""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from tests.chaos.faults import LONG
from tests.chaos.field import Field, Size, open_field
from tests.chaos.material import make
from tests.chaos.sequence import Outcome, play
from tests.chaos.soak import soak

_EVERY_FAULT = Size(light=3, real=2, frames=300, small_disks=True)
_SOAK = Size(light=12, real=0)
_DRIVE_S, _SOAK_DRIVE_S = 120.0, 45.0


def main() -> None:
    arguments = _arguments()
    out: Path = arguments.out
    out.mkdir(parents=True, exist_ok=True)
    parts: dict[str, Any] = {}
    if arguments.faults:
        parts["faults"] = _part(
            "every fault",
            _EVERY_FAULT,
            _DRIVE_S,
            lambda field: play(field, [fault for fault in LONG if arguments.only in fault.name]),
            previous=arguments.previous,
        )
    if arguments.soak_minutes > 0:
        work = partial(soak, minutes=arguments.soak_minutes, seed=arguments.seed, say=_say)
        title = f"soak of {arguments.soak_minutes:g} minutes, seed {arguments.seed}"
        parts["soak"] = _part(title, _SOAK, _SOAK_DRIVE_S, work, gaps=False)
    parts["load_average"] = os.getloadavg()
    (out / "chaos.json").write_text(json.dumps(parts, indent=1) + "\n")
    _say(str(out / "chaos.json"))
    sys.exit(0 if all(part["ok"] for name, part in parts.items() if name != "load_average") else 1)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m tests.chaos", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("out/chaos"))
    parser.add_argument("--soak-minutes", type=float, default=30.0, help="0: no soak")
    parser.add_argument("--seed", type=int, default=1, help="of the soak's faults")
    parser.add_argument("--no-faults", dest="faults", action="store_false", help="the soak alone")
    parser.add_argument("--only", default="", help="faults whose name contains this")
    parser.add_argument("--previous", help="git ref to upgrade from; without: this version under another number")
    return parser.parse_args()


def _part(
    title: str, size: Size, drive_s: float, work: Any, *, previous: str | None = None, gaps: bool = True
) -> dict[str, Any]:
    """gaps: whether they are judged; the soak loads the machine until it has no time to spare, and prints them only."""
    _say(f"-- {title}: {size.light} light robots, {size.real} real ones, {size.replicas} replicas")
    begun_s = time.monotonic()
    outcomes: list[Outcome] = []
    with (
        tempfile.TemporaryDirectory(prefix="splitslam-chaos-") as folder,
        open_field(Path(folder), partial(make, Path(folder) / "drive", drive_s), size) as field,
    ):
        field.previous = previous
        outcomes = work(field)
    return _told(field, outcomes, time.monotonic() - begun_s, gaps=gaps)


def _told(field: Field, outcomes: list[Outcome], took_s: float, *, gaps: bool) -> dict[str, Any]:
    late = [outcome.line() for outcome in outcomes if gaps and not outcome.in_time]
    for line in (*field.wrong, *late):
        _say(f"   WRONG {line}")
    for line in field.skipped:
        _say(f"   not done here: {line}")
    fleet = field.fleet
    _say(f"   {fleet.judged} sessions, {fleet.scans} scans, {len(outcomes)} faults, {len(field.wrong)} wrong")
    return {
        "ok": not field.wrong and not late,
        "took_s": took_s,
        "sessions": fleet.judged,
        "scans": fleet.scans,
        "outcomes": [asdict(outcome) for outcome in outcomes],
        "wrong": field.wrong,
        "late": late,
        "not_done": field.skipped,
    }


def _say(text: str) -> None:
    print(text, flush=True)


if __name__ == "__main__":
    main()
