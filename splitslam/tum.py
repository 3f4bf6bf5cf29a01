"""Trajectories as TUM files: `stamp_s tx ty tz qx qy qz qw`, one pose a line, `#` starts a comment."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from splitslam.errors import InputError

_LAYOUT = "stamp_s tx ty tz qx qy qz qw"
_UNIT_TOLERANCE = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Poses T_a_b of one frame b in another a, strictly increasing in time.

    stamps_ns: (N,) int64. positions_m: (N, 3) float64, m, frame a. quats_xyzw: (N, 4) float64, unit.
    """

    stamps_ns: NDArray[np.int64]
    positions_m: NDArray[np.float64]
    quats_xyzw: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def __getitem__(self, rows: slice | NDArray) -> Trajectory:
        return Trajectory(self.stamps_ns[rows], self.positions_m[rows], self.quats_xyzw[rows])

    @property
    def path_m(self) -> float:
        """Length of the line through the positions."""
        return float(np.linalg.norm(np.diff(self.positions_m, axis=0), axis=1).sum())


def tum_line(stamp_ns: int, position_m: NDArray[np.float64], quat_xyzw: NDArray[np.float64]) -> str:
    """A position (3,) and a unit quaternion (4,); the stamp goes from int64 to 9 decimals without a float between."""
    seconds, nanoseconds = divmod(int(stamp_ns), 1_000_000_000)
    x, y, z = position_m.tolist()  # plain floats: numpy's take longer to write than to work out
    qx, qy, qz, qw = quat_xyzw.tolist()
    return f"{seconds}.{nanoseconds:09d} {x:.9f} {y:.9f} {z:.9f} {qx:.9f} {qy:.9f} {qz:.9f} {qw:.9f}\n"


def write_tum(path: Path, trajectory: Trajectory) -> None:
    """Write all poses to `path`, which is replaced."""
    rows = zip(trajectory.stamps_ns.tolist(), trajectory.positions_m, trajectory.quats_xyzw, strict=True)
    with path.open("w", encoding="ascii") as file:
        file.writelines(tum_line(*row) for row in rows)


def read_tum(path: Path) -> Trajectory:
    """Read `path`. Raises InputError that names the file, the line and what was expected."""
    stamps, numbers = [], []
    for where, fields in _lines(path):
        if len(fields) != 8:
            raise InputError(f"{where}: expected 8 numbers ({_LAYOUT}), found {len(fields)} fields")
        stamps.append(_stamp_ns(where, fields[0]))
        if len(stamps) > 1 and stamps[-1] <= stamps[-2]:
            raise InputError(f"{where}: stamp_s: expected later than the pose before, found {fields[0]}")
        numbers.append(_pose(where, fields[1:]))
    if not stamps:
        raise InputError(f"{path}: expected poses ({_LAYOUT}), found none")
    values = np.array(numbers)
    quats = values[:, 3:] / np.linalg.norm(values[:, 3:], axis=1, keepdims=True)
    return Trajectory(np.array(stamps, np.int64), np.ascontiguousarray(values[:, :3]), quats)


def _lines(path: Path) -> Iterator[tuple[str, list[str]]]:
    try:
        with path.open(encoding="utf-8") as file:
            for number, line in enumerate(file, start=1):
                if fields := line.partition("#")[0].split():
                    yield f"{path}:{number}", fields
    except UnicodeDecodeError:
        raise InputError(f"{path}: expected a text file with poses ({_LAYOUT}), found binary data") from None
    except OSError as error:
        raise InputError(f"{path}: expected a trajectory in TUM format ({error.strerror})") from None


def _stamp_ns(where: str, text: str) -> int:
    try:
        stamp_ns = int((Decimal(text) * 1_000_000_000).to_integral_value())
    except (InvalidOperation, ValueError, OverflowError):
        raise InputError(f"{where}: stamp_s: expected seconds, found {text!r}") from None
    if abs(stamp_ns) >= 1 << 63:
        raise InputError(f"{where}: stamp_s: expected seconds, found {text!r}")
    return stamp_ns


def _pose(where: str, fields: list[str]) -> list[float]:
    try:
        values = [float(field) for field in fields]
    except ValueError:
        raise InputError(f"{where}: expected 8 numbers ({_LAYOUT}), found {' '.join(fields)!r}") from None
    if not np.isfinite(values).all():
        raise InputError(f"{where}: expected finite numbers, found {' '.join(fields)!r}")
    if abs(np.linalg.norm(values[3:]) - 1.0) > _UNIT_TOLERANCE:
        raise InputError(f"{where}: qx qy qz qw: expected a unit quaternion, found {' '.join(fields[3:])}")
    return values
