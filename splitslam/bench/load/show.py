"""The load benchmark on the terminal."""

from __future__ import annotations

from typing import Any

from rich.console import Console

from splitslam.bench.figures_table import figures_table

_WIDTH = 110


def show(result: dict[str, Any], console: Console | None = None) -> None:
    """A row a try, and what one robot costs."""
    console = console or Console(highlight=False)
    if not console.is_terminal:
        console.width = _WIDTH
    machine, best = result["machine"], result["best"]
    title = f"Robots at 10 Hz, one map service and the generator on {machine['cpus']} cores"
    columns = ("start", "frames", "lost", "p50 ms", "p99 ms", "max ms", "sent late\np99 ms", "", "cores")
    table = figures_table(title, "robots", *columns)
    for trial in result["trials"]:
        answer, verdict = trial["answer_ms"], "ok" if trial["passed"] else "wrong" if trial["wrong"] else "late"
        table.add_row(
            str(trial["robots"]),
            trial["start"],
            str(trial["frames"]),
            str(trial["unanswered"]),
            *(f"{answer[key]:.1f}" for key in ("p50", "p99", "max")),
            f"{trial['late_ms']['p99']:.1f}",
            verdict,
            f"{trial['cost']['cores'] * trial['robots']:.2f}",
        )
    console.print(table)
    for line in best["wrong"]:
        console.print(line, style="red", markup=False)
    bar = f"all answers right, p99 under {result['bar_ms']:g} ms"
    console.print(f"largest number of robots with {bar}: {result['largest'] or 'none of those tried'}")
    cost = best["cost"]
    console.print(
        f"one robot: {cost['cores']:.3f} cores (generator {cost['generator_cores']:.3f}), {cost['memory_mb']:.0f} MB, "
        f"{cost['store_gb_a_day']:.2f} GB of store a day, {cost['uplink_kbps']:.0f} kbit/s up, "
        f"{cost['downlink_kbps']:.0f} down; the service without robots {best['idle_mb']:.0f} MB"
    )
