"""`python -m fpga_overlay.syn.report`: resources per core, measured afresh; --write keeps them in report.json."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path

from fpga_overlay.syn.yosys import RTL, TOOL, Resources, synthesise

REPORT = Path(__file__).with_name("report.json")
CORES = ("deskew_core", "feature_core", "splitslam_top")
# What each may take (uram: of the ZCU104's 96). A core in the pipeline is never allowed to grow into the next one's.
CEILINGS = {
    "deskew_core": Resources(dsp=48, bram36=12, uram=0, lut=8_000, ff=10_000),
    "splitslam_top": Resources(dsp=64, bram36=24, uram=32, lut=16_000, ff=20_000),
}


def report() -> dict[str, object]:
    """The JSON object of report.json for the cores there are."""
    there = [core for core in CORES if (RTL / f"{core}.sv").exists()]
    cores = {core: asdict(synthesise(core)) for core in there}
    return {"tool": TOOL, "label": "Yosys synthesis, not placed and routed", "cores": cores}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help=f"keep the result in {REPORT.name}")
    options = parser.parse_args()
    text = json.dumps(report(), indent=2)
    print(text)
    if options.write:
        REPORT.write_text(text + "\n")


if __name__ == "__main__":
    main()
