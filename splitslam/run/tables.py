"""keyframes.csv and scans.csv: what a run's folder needs besides its trajectories to be looked at again."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from splitslam.errors import InputError

_POSE = ("tx", "ty", "tz", "qx", "qy", "qz", "qw")
_KEYFRAMES = ("keyframe", "points", *_POSE)
_SCANS = ("stamp_ns", "bytes", "dense", "round_trip_ms")
Pose = tuple[float, float, float, float, float, float, float]


@dataclass(frozen=True, slots=True)
class KeyframeRow:
    """Keyframes are in map.ply one after the other, `points` of each. pose: T_map_lidar, m and a unit quaternion."""

    keyframe: int
    points: int
    pose: Pose


@dataclass(frozen=True, slots=True)
class ScanRow:
    """bytes: of the encoded frame. round_trip_ms: None where no answer came."""

    stamp_ns: int
    bytes: int
    dense: bool
    round_trip_ms: float | None


def write_keyframes(path: Path, rows: Iterable[KeyframeRow]) -> None:
    lines = ((row.keyframe, row.points, *(f"{value:.9f}" for value in row.pose)) for row in rows)
    _write(path, _KEYFRAMES, lines)


def read_keyframes(path: Path) -> list[KeyframeRow]:
    """Raises InputError that names the line and what was expected."""
    rows = []
    for where, line in _read(path, _KEYFRAMES):
        try:
            pose = tuple(float(value) for value in line[2:])
            rows.append(KeyframeRow(int(line[0]), int(line[1]), pose))  # type: ignore[arg-type]
        except ValueError:
            raise InputError(f"{where}: expected numbers ({','.join(_KEYFRAMES)})") from None
    return rows


def write_scans(path: Path, edge: dict[str, Any]) -> None:
    """From the agent's series."""
    series = zip(
        edge["stamps_ns_by_scan"],
        edge["bytes_by_scan"],
        edge["dense_by_scan"],
        edge["round_trip_ms_by_scan"],
        strict=True,
    )
    lines = ((ns, size, int(dense), "" if ms is None else f"{ms:.3f}") for ns, size, dense, ms in series)
    _write(path, _SCANS, lines)


def read_scans(path: Path) -> list[ScanRow]:
    """Raises InputError."""
    rows = []
    for where, (stamp_ns, size, dense, round_trip_ms) in _read(path, _SCANS):
        try:
            ms = float(round_trip_ms) if round_trip_ms else None
            rows.append(ScanRow(int(stamp_ns), int(size), dense == "1", ms))
        except ValueError:
            raise InputError(f"{where}: expected numbers ({','.join(_SCANS)})") from None
    return rows


def _write(path: Path, header: Sequence[str], lines: Iterable[Sequence[Any]]) -> None:
    with path.open("w", encoding="ascii", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([header, *lines])


def _read(path: Path, header: Sequence[str]) -> Iterable[tuple[str, list[str]]]:
    try:
        with path.open(encoding="ascii", newline="") as file:
            lines = list(csv.reader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: expected a table ({','.join(header)}): {error}") from None
    if not lines or tuple(lines[0]) != tuple(header):
        raise InputError(f"{path}:1: expected the columns {','.join(header)}")
    for number, line in enumerate(lines[1:], start=2):
        if len(line) != len(header):
            raise InputError(f"{path}:{number}: expected {len(header)} columns, found {len(line)}")
        yield f"{path}:{number}", line
