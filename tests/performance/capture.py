"""The kernels in which a drive spends its time, each with the arguments of a call as it really came."""

from __future__ import annotations

import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numba.core.dispatcher import Dispatcher

from splitslam.bench.in_one_process import Seen, run_both
from splitslam.features import FeatureFrame

_PACKAGES = ("edge_agent", "splitslam", "map_service")
_SCANS, _LAST = 60, 15  # of the drive: in all; from which calls are taken, when the map is there
_DECODE = "decode"


@dataclass(frozen=True, slots=True, eq=False)
class Call:
    """name: module and kernel, behind `decode:` where the codec's kernels run backwards.

    arguments: copies, as they were before the call. per_scan: how often it is called. share: of all kernels' time.
    """

    name: str
    kernel: Callable[..., Any]
    arguments: tuple[Any, ...]
    per_scan: float
    share: float


def kernel_calls(recording: Path, robot: Path) -> list[Call]:
    """Both pipelines on the drive's first scans, odometry only; a call of every kernel, hottest first.

    Of a kernel's calls the one with the most bytes, the last of equals: the run repeats itself, and so does the choice.
    """
    run_both(recording, robot, max_scans=_SCANS)  # every kernel is compiled for what it gets
    log = _Log()

    def wire(seen: Seen) -> FeatureFrame:
        with log.doing(_DECODE):
            frame = seen.decoded()
        log.scans += 1
        return frame

    with _tapped(log):
        run_both(recording, robot, max_scans=_SCANS, wire=wire)
    whole_ns = sum(log.spent_ns.values())
    calls = [
        Call(name, log.kernels[name], log.arguments[name], log.count[name] / _LAST, spent_ns / whole_ns)
        for name, spent_ns in log.spent_ns.items()
    ]
    return sorted(calls, key=lambda call: -call.share)


def copied(value: Any) -> Any:
    """An argument that a kernel may change; writeable or not as it was, or numba would compile for another type."""
    if isinstance(value, np.ndarray):
        copy = np.empty_like(value)
        copy[...] = value
        copy.flags.writeable = value.flags.writeable
        return copy
    if isinstance(value, tuple):
        return tuple(copied(part) for part in value)
    return value


def nbytes(value: Any) -> int:
    """Of an argument's arrays."""
    if isinstance(value, tuple):
        return sum(nbytes(part) for part in value)
    return value.nbytes if isinstance(value, np.ndarray) else 0


@dataclass(slots=True)
class _Log:
    scans: int = 0
    phase: str = ""
    spent_ns: Counter[str] = field(default_factory=Counter)
    count: Counter[str] = field(default_factory=Counter)
    arguments: dict[str, tuple[Any, ...]] = field(default_factory=dict)
    kernels: dict[str, Dispatcher] = field(default_factory=dict)

    @contextmanager
    def doing(self, phase: str) -> Iterator[None]:
        self.phase = phase
        yield
        self.phase = ""


class _Tap:
    """In a kernel's place while a drive runs: passes every call on, and notes it."""

    def __init__(self, kernel: Dispatcher, log: _Log) -> None:
        self._kernel, self._log = kernel, log
        self._name = f"{kernel.py_func.__module__}.{kernel.py_func.__name__}"

    def __call__(self, *arguments: Any) -> Any:
        log = self._log
        if log.scans < _SCANS - _LAST:
            return self._kernel(*arguments)
        name = f"{log.phase}:{self._name}" if log.phase else self._name
        if nbytes(arguments) >= nbytes(log.arguments.get(name, ())):
            log.arguments[name] = copied(arguments)
            log.kernels[name] = self._kernel
        begun_ns = time.thread_time_ns()
        result = self._kernel(*arguments)
        log.spent_ns[name] += time.thread_time_ns() - begun_ns
        log.count[name] += 1
        return result


@contextmanager
def _tapped(log: _Log) -> Iterator[None]:
    """Taps wherever a module of ours holds a kernel. What is compiled calls its kernels without them."""
    taps: dict[int, _Tap] = {}
    held = [
        (module, attribute, value)
        for name, module in list(sys.modules.items())
        if name.split(".")[0] in _PACKAGES
        for attribute, value in list(vars(module).items())
        if isinstance(value, Dispatcher)
    ]
    for module, attribute, kernel in held:
        setattr(module, attribute, taps.setdefault(id(kernel), _Tap(kernel, log)))
    try:
        yield
    finally:
        for module, attribute, kernel in held:
            setattr(module, attribute, kernel)
