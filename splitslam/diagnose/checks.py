"""What can be seen of a robot's health without its help: one record for each thing that was looked at."""

from __future__ import annotations

import ctypes
import os
import shutil
import socket
from dataclasses import asdict, dataclass
from enum import Enum
from pathlib import Path
from typing import Any

_TIME_ERROR = 5
_CONNECT_S = 3.0
_MB = 2**20
_LEAST_FREE_MB = 256


class Verdict(Enum):
    """unknown: it could not be looked at."""

    OK = "ok"
    WARN = "warn"
    FAIL = "fail"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True)
class Check:
    """One thing and how it is; text: what was found, and what was expected unless it is well."""

    name: str
    verdict: Verdict
    text: str

    def as_dict(self) -> dict[str, Any]:
        return asdict(self) | {"verdict": self.verdict.value}


class _Timex(ctypes.Structure):
    """struct timex of adjtimex(2), as far as it is read; the kernel fills in the rest."""

    _fields_ = (
        ("modes", ctypes.c_uint),
        ("offset", ctypes.c_long),
        ("freq", ctypes.c_long),
        ("maxerror_us", ctypes.c_long),
        ("esterror_us", ctypes.c_long),
        ("rest", ctypes.c_long * 32),
    )


def clock() -> Check:
    """Whether something keeps the clock: the kernel knows (adjtimex), whoever does it."""
    timex = _Timex()
    state = ctypes.CDLL(None, use_errno=True).adjtimex(ctypes.byref(timex))
    if state < 0:
        return Check("clock", Verdict.UNKNOWN, os.strerror(ctypes.get_errno()))
    error = f"at most {timex.maxerror_us * 1e-6:.3g} s off by its own account"
    if state == _TIME_ERROR:
        return Check("clock", Verdict.WARN, "not kept by NTP or PTP; expected when robots share a map or a log")
    return Check("clock", Verdict.OK, error)


def disk(name: str, folder: Path, needed_bytes: int) -> Check:
    """Room where the spool is."""
    try:
        free = shutil.disk_usage(folder).free
    except OSError as error:
        return Check(name, Verdict.FAIL, f"{folder}: {error.strerror}")
    text = f"{folder}: {free // _MB} MB free"
    if free < needed_bytes:
        return Check(name, Verdict.WARN, f"{text}, expected {needed_bytes // _MB} MB, what it may take")
    return Check(name, Verdict.OK, text)


def memory() -> Check:
    """What the kernel says could be had."""
    lines = Path("/proc/meminfo").read_text().splitlines()
    values = {line.split(":")[0]: int(line.split()[1]) // 1024 for line in lines if line.endswith("kB")}
    free, total = values.get("MemAvailable", 0), values.get("MemTotal", 0)
    text = f"{free} of {total} MB available"
    if free < _LEAST_FREE_MB:
        return Check("memory", Verdict.WARN, f"{text}, expected {_LEAST_FREE_MB}")
    return Check("memory", Verdict.OK, text)


def reachable(name: str, host: str, port: int) -> Check:
    """A TCP connection to there."""
    try:
        with socket.create_connection((host, port), timeout=_CONNECT_S):
            return Check(name, Verdict.OK, f"{host}:{port} accepts connections")
    except OSError as error:
        return Check(name, Verdict.FAIL, f"{host}:{port}: {error.strerror or error}; expected a connection")
