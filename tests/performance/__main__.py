"""`make bounds`: takes the bounds anew, on a quiet machine, and says what changed."""

from __future__ import annotations

import json
import os
from dataclasses import asdict
from pathlib import Path

from tests.conftest import ROOT
from tests.performance.capture import kernel_calls
from tests.performance.gate import BOUNDS, load_bounds, take_bounds
from tests.performance.reference import Reference


def main() -> None:
    """Writes bounds.json."""
    folder = Path(os.environ.get("SPLITSLAM_DATA") or ROOT.parent / "shared" / "data") / "yard1"
    calls = kernel_calls(folder / "yard1.bag", folder / "yard1.yaml")
    before = load_bounds() if BOUNDS.exists() else {}
    bounds = take_bounds(calls, Reference())
    shares = {call.name: call.share for call in calls}
    for name, bound in bounds.items():
        was = f"{before[name].ratio:.3f}" if name in before else "-"
        print(f"{shares[name]:5.1%}  {was:>8} -> {bound.ratio:8.3f}, {bound.per_scan:5.1f} a scan  {name}")
    for name in sorted(set(before) - set(bounds)):
        print(f"no bound any more: {name}, {shares.get(name, 0.0):.1%}")
    made = {name: asdict(bound) for name, bound in sorted(bounds.items())}
    BOUNDS.write_text(json.dumps(made, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
