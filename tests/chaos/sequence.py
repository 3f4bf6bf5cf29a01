"""One fault after the other on the same field, and a line about each."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass

from tests.chaos.faults import Fault
from tests.chaos.field import Field

_SETTLE_S = 30.0


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a fault has shown. gap_s: the longest silence that a robot had during it. wrong: during it; the end of each
    session tells the rest.
    """

    fault: str
    took_s: float
    gap_s: float
    bar_s: float | None
    wrong: tuple[str, ...]

    @property
    def in_time(self) -> bool:
        return self.bar_s is None or self.gap_s <= self.bar_s

    def line(self) -> str:
        bar = "" if self.bar_s is None else f" (at most {self.bar_s:g})"
        return f"{self.fault:<28} {self.took_s:5.1f} s, longest gap {self.gap_s:5.2f} s{bar}  {self.verdict}"

    @property
    def verdict(self) -> str:
        if self.wrong:
            return f"{len(self.wrong)} wrong: {self.wrong[0]}"
        return "ok" if self.in_time else "too long"


def play(field: Field, faults: Iterable[Fault]) -> list[Outcome]:
    """Each fault begins when every robot is answered again; every outcome is printed as it is known."""
    outcomes = []
    for fault in faults:
        field.all_up()
        field.expect(field.fleet.settled(time.monotonic(), _SETTLE_S), f"before {fault.name}: robots unanswered")
        outcomes.append(inflict(field, fault))
        print(outcomes[-1].line(), flush=True)
    return outcomes


def inflict(field: Field, fault: Fault) -> Outcome:
    """The fault, and the time until every robot is answered again."""
    known = len(field.wrong)
    from_s = time.monotonic()
    fault.do(field)
    mended_s = time.monotonic()
    field.expect(field.fleet.settled(mended_s, _SETTLE_S), f"{fault.name}: robots unanswered {_SETTLE_S:g} s after it")
    gap_s = field.fleet.gap_s(from_s, time.monotonic())
    return Outcome(fault.name, time.monotonic() - from_s, gap_s, fault.gap_s, tuple(field.wrong[known:]))
