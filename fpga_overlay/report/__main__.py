"""`python -m fpga_overlay.report`: one JSON object on stdout, how the prediction is made up on stderr."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping

from fpga_overlay.golden.packet import BYPASS_FEATURES
from fpga_overlay.report import cores
from fpga_overlay.report.board import Zcu104
from fpga_overlay.report.prediction import EndToEnd, predict
from fpga_overlay.report.resources import resources

PAPER_MS = 7.07  # Table V, with FPGA


def main() -> None:
    """Measures everything; minutes the first time, because the cores are verilated and synthesised."""
    json.dump(report(), sys.stdout, indent=2)
    print()


def report() -> dict:
    """See docs/benchmarks.md for every key."""
    board = Zcu104()
    counted = resources()
    deskew, both = cores.deskew_core(), cores.both_cores()
    alone = {
        f"cycles_{name}": cores.cycles(deskew, cores.full_request(rings, columns))
        for name, (rings, columns) in {"28800": (16, 1800), "64x2048": (64, 2048), "128x2048": (128, 2048)}.items()
    }
    with_features, without = (
        predict(board, both, cores.full_request(16, 1800, flags), features=not flags) for flags in (0, BYPASS_FEATURES)
    )
    explain(with_features, without, board)
    return {
        "deskew": {**alone, "max_error_mm": round(cores.max_error_mm(deskew), 4), **counted["deskew"]},
        "features": {
            "cycles_28800": cores.cycles(both, cores.full_request(16, 1800)),
            "mismatched_points": cores.mismatches(both, cores.compared_scans()),
            **counted["features"],
        },
        "total": counted["total"],
        "core_ms": round(board.clocks_ms(alone["cycles_28800"]), 4),
        "end_to_end_ms": round(with_features.total_ms, 3),
        "end_to_end": {
            "label": "predicted: never run on a board",
            "resources": "Yosys synthesis, not placed and routed",
            "features_in_logic": with_features.as_json(),
            "features_on_processor": without.as_json(),
            "board": board.as_json(),
        },
    }


def explain(with_features: EndToEnd, without: EndToEnd, board: Zcu104) -> None:
    """The parts of the prediction as a table, for people."""
    print(f"28,800 points on the ZCU104, predicted, ms; never run on a board (the paper: {PAPER_MS})", file=sys.stderr)
    rows: list[tuple[str, Mapping[str, float]]] = [
        ("features in the logic", with_features.parts_ms),
        ("features on the processor", without.parts_ms),
    ]
    for part in with_features.parts_ms:
        print(f"  {part:<18}" + "".join(f"{parts[part]:10.3f}" for _, parts in rows), file=sys.stderr)
    print(f"  {'total':<18}{with_features.total_ms:10.3f}{without.total_ms:10.3f}", file=sys.stderr)
    share = f"{with_features.processor_share:.0%} and {without.processor_share:.0%}"
    print(
        f"  {'feature marks':<18}{with_features.marks_ms:10.3f}{without.marks_ms:10.3f}  (not in the total)",
        file=sys.stderr,
    )
    print(f"  left: {rows[0][0]}; right: {rows[1][0]}; share of the processor: {share}", file=sys.stderr)
    print(f"  an A53 is taken as {board.cpu_factor:g} times slower than a core here", file=sys.stderr)


if __name__ == "__main__":
    main()
