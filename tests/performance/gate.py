"""Ratios of kernels to the reference, their bounds, and the verdict; `make bounds` takes new ones."""

from __future__ import annotations

import json
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tests.performance.capture import Call, copied
from tests.performance.reference import Reference

BOUNDS = Path(__file__).with_name("bounds.json")
# Twice as slow must be seen; another processor, and whatever runs beside it, must not.
TOLERATED = 1.5
WORTH_A_BOUND, NEEDS_A_BOUND = 0.02, 0.05  # of all kernels' time: apart, as shares are measured and waver
_FEWEST, _MOST, _SPENT_NS = 30, 400, 4_000_000  # repeats; and for how long a short call is repeated
_ATTEMPTS, _PAUSE_S, _TAKEN = 8, 0.2, 9


@dataclass(frozen=True, slots=True)
class Bound:
    """What a kernel was when bounds were taken. ratio: of a call to the reference. per_scan: calls."""

    ratio: float
    per_scan: float


@dataclass(frozen=True, slots=True)
class Verdict:
    """What a kernel is now, beside its bound."""

    name: str
    ratio: float
    per_scan: float
    bound: Bound

    @property
    def slower(self) -> float:
        """How many times slower a call is than it was."""
        return self.ratio / self.bound.ratio

    @property
    def oftener(self) -> float:
        """How many times as often it is called."""
        return self.per_scan / self.bound.per_scan

    @property
    def red(self) -> bool:
        """Slower, or called more often, than is tolerated."""
        return max(self.slower, self.oftener) > TOLERATED

    def __str__(self) -> str:
        return f"{self.name}: a call {self.slower:.2f} times as long, {self.oftener:.2f} times as many a scan"


def judge(call: Call, reference: Reference, bound: Bound) -> Verdict:
    """Measures until it is not red, at most a few times: what disturbs it passes, what is in the code does not."""
    least = float("inf")
    for _ in range(_ATTEMPTS):
        least = min(least, ratio(call, reference))
        verdict = Verdict(call.name, least, call.per_scan, bound)
        if not verdict.red:
            break
        time.sleep(_PAUSE_S)
    return verdict


def ratio(call: Call, reference: Reference) -> float:
    """CPU time of the call in that of the reference: the shortest of each, taken in turns."""
    given = copied(call.arguments)
    least_ns, reference_ns = cpu_ns(call.kernel, *given), 1 << 62
    for _ in range(min(max(_SPENT_NS // least_ns, _FEWEST), _MOST)):
        reference_ns = min(reference_ns, cpu_ns(reference))
        _restore(given, call.arguments)
        least_ns = min(least_ns, cpu_ns(call.kernel, *given))
    return least_ns / reference_ns


def cpu_ns(work: Callable[..., Any], *arguments: Any) -> int:
    """CPU time of this thread."""
    begun_ns = time.thread_time_ns()
    work(*arguments)
    return time.thread_time_ns() - begun_ns


def load_bounds() -> dict[str, Bound]:
    """By kernel."""
    return {name: Bound(**bound) for name, bound in json.loads(BOUNDS.read_text(encoding="utf-8")).items()}


def take_bounds(calls: list[Call], reference: Reference) -> dict[str, Bound]:
    """Of every kernel that is worth one; ratios are medians."""
    return {
        call.name: Bound(
            round(statistics.median(ratio(call, reference) for _ in range(_TAKEN)), 4), round(call.per_scan, 3)
        )
        for call in calls
        if call.share > WORTH_A_BOUND
    }


def _restore(given: Any, original: Any) -> None:
    """Whatever a call has changed is as it was, and as warm."""
    if isinstance(given, tuple):
        for part, source in zip(given, original, strict=True):
            _restore(part, source)
    elif isinstance(given, np.ndarray) and given.flags.writeable:
        np.copyto(given, original)
