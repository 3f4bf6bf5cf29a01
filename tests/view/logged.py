"""What a scene logs, kept instead of recorded: archetypes as arrays by entity."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, eq=False)
class Entry:
    """stamp_ns None: it holds at all times. kind: of the archetype. fields: those that are set, as Python values."""

    stamp_ns: int | None
    kind: str
    fields: dict[str, Any]


class Logged:
    """Stands for a rr.RecordingStream."""

    def __init__(self) -> None:
        self.entries: dict[str, list[Entry]] = defaultdict(list)
        self._stamp_ns: int | None = None
        self.timelines: set[str] = set()

    def set_time(self, timeline: str, *, timestamp: np.datetime64) -> None:
        self.timelines.add(timeline)
        self._stamp_ns = int(timestamp.astype("datetime64[ns]").astype(np.int64))

    def log(self, path: str, what: rr.AsComponents, *, static: bool = False) -> None:
        fields = {
            str(batch.component_descriptor().component).partition(":")[2]: batch.as_arrow_array().to_pylist()
            for batch in what.as_component_batches()
        }
        path = path.lstrip("/")
        self.entries[path].append(Entry(None if static else self._stamp_ns, type(what).__name__, fields))

    def of(self, path: str, kind: str = "") -> list[Entry]:
        """Of one entity, in order, without what holds at all times."""
        return [e for e in self.entries.get(path, []) if e.stamp_ns is not None and kind in ("", e.kind)]

    def paths(self, prefix: str) -> list[str]:
        return sorted(path for path in self.entries if path.startswith(prefix) and self.of(path))

    def map_of(self, robot: str) -> NDArray[np.float64]:
        """(N, 3), frame `map`: all points of a robot's map, as they lie at last."""
        lying = [
            _placed(self.of(path, "Transform3D"), points(self.of(path, "Points3D")[-1])) for path in self._map(robot)
        ]
        return np.concatenate([np.zeros((0, 3)), *lying])

    def _map(self, robot: str) -> list[str]:
        return [path for path in self.paths(f"world/{robot}/map/") if self.of(path, "Points3D")]

    def way_of(self, robot: str) -> list[NDArray[np.float64]]:
        """Pieces (N, 3) of the corrected way, frame `map`, as they lie at last: each once, in order of entities."""
        pieces = []
        for path in self.paths(f"world/{robot}/trajectory/"):
            for strip in (drawn := self.of(path, "LineStrips3D")) and drawn[-1].fields["strips"]:
                pieces.append(_placed(self.of(path, "Transform3D"), np.array(strip, float).reshape(-1, 3)))
        return pieces


def _placed(transforms: list[Entry], points: NDArray[np.float64]) -> NDArray[np.float64]:
    T = pose(transforms[-1])
    return points @ T[:3, :3].T + T[:3, 3]


def points(entry: Entry) -> NDArray[np.float64]:
    """(N, 3) of a Points3D."""
    return np.array(entry.fields["positions"], float).reshape(-1, 3)


def pose(entry: Entry) -> NDArray[np.float64]:
    """(4, 4) of a Transform3D."""
    T = np.eye(4)
    T[:3, 3] = entry.fields["translation"][0]
    T[:3, :3] = np.reshape(entry.fields["mat3x3"][0], (3, 3)).T  # column by column
    return T
