"""`python -m fpga_overlay.tb.mutations [NAME ...]`: deliberate mistakes in the RTL, each caught by a named test.

A mistake is made in a copy. The lists are the `MUTATIONS` of the files `mutations_*.py` beside this one. Prints a
table; exit code 1 if a mistake survives its test, does not apply (its text must occur once) or breaks the tools, or
if a test fails without any.
"""

from __future__ import annotations

import argparse
import importlib
import shutil
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from fpga_overlay.modules import RTL
from fpga_overlay.tb.mutation import Mutation
from fpga_overlay.tb.simulation import REPOSITORY, SimulationFailed, ToolFailed, simulate

COPIES = REPOSITORY / "build" / "fpga" / "mutations"
CAUGHT = "caught"


def all_mutations() -> list[Mutation]:
    """Of every list, in the order of the files' names."""
    names = sorted(path.stem for path in Path(__file__).parent.glob("mutations_*.py"))
    return [m for name in names for m in importlib.import_module(f"fpga_overlay.tb.{name}").MUTATIONS]


def verdict(mutation: Mutation) -> str:
    """CAUGHT, or what is wrong."""
    text = (RTL / mutation.file).read_text()
    if text.count(mutation.old) != 1:
        return f"does not apply: its text occurs {text.count(mutation.old)} times in {mutation.file}"
    copy = COPIES / mutation.name
    shutil.rmtree(copy, ignore_errors=True)
    shutil.copytree(RTL, copy)
    (copy / mutation.file).write_text(text.replace(mutation.old, mutation.new))
    try:
        parameters = dict(mutation.parameters)
        simulate(mutation.top, mutation.bench, parameters, only=mutation.only, rtl=copy, flags=["-Wno-fatal"])
    except SimulationFailed:
        return CAUGHT
    except ToolFailed as error:
        return f"breaks the tools: {error}"
    return "SURVIVES"


def baseline(mutations: Sequence[Mutation]) -> list[str]:
    """The tests that fail without a mutation."""
    failures = []
    for top, bench, parameters, only in dict.fromkeys((m.top, m.bench, m.parameters, m.only) for m in mutations):
        try:
            simulate(top, bench, dict(parameters), only=only)
        except SimulationFailed as error:
            failures.append(f"{only} fails on the RTL as it is: {error}")
    return failures


def main() -> int:
    parser = argparse.ArgumentParser(description="deliberate mistakes in the RTL, each caught by a named test")
    parser.add_argument("names", nargs="*", help="only these mutations")
    options = parser.parse_args()
    mutations = [m for m in all_mutations() if not options.names or m.name in options.names]
    failures = baseline(mutations)
    start = time.monotonic()
    with ThreadPoolExecutor(2) as pool:
        verdicts = list(pool.map(verdict, mutations))
    width = max(len(m.name) for m in mutations)
    for mutation, found in zip(mutations, verdicts, strict=True):
        print(f"{mutation.name:{width}}  {mutation.file:22}  {mutation.test:58}  {found}")
    survivors = [v for v in verdicts if v != CAUGHT]
    print(f"{len(mutations) - len(survivors)} of {len(mutations)} caught in {time.monotonic() - start:.0f} s")
    print("\n".join(failures), end="")
    return int(bool(survivors or failures))


if __name__ == "__main__":
    sys.exit(main())
