"""One system on one case is a cell of the tables: computed once, kept as JSON, never computed again."""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks import peers, scoring, sharpness
from benchmarks.consistency import consistency
from benchmarks.drives import Case, Files, prepare
from benchmarks.dump import read_scans, scan_stamps_ns, write_dump
from benchmarks.ours import run_ours
from splitslam.alignment import interpolate
from splitslam.tum import Trajectory, read_tum, write_tum

# Ours: what is switched off, and the deskew back end.
OURS: dict[str, tuple[tuple[str, ...], str]] = {
    "ours_odometry": (("loops", "gnss"), "auto"),
    "ours": ((), "auto"),
    "deskew_rotation": (("loops", "gnss"), "rotation"),
    "deskew_off": (("loops", "gnss"), "off"),
}
SHARPNESS = "sharpness"
_COMPARED = ("ours_odometry", "kiss_icp")  # whose maps `sharpness` compares
Cell = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Limits:
    """How much of each drive is run; None: all."""

    seconds: float | None = None
    max_scans: int | None = None


class Store:
    """The cells in a folder, `CASE.SYSTEM.json`, and the trajectories beside them."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        folder.mkdir(parents=True, exist_ok=True)

    def get(self, case: Case, system: str) -> Cell | None:
        """The cell, or None when it has not been computed."""
        path = self._path(case, system, "json")
        return json.loads(path.read_text()) if path.exists() else None

    def put(self, case: Case, system: str, cell: Cell) -> None:
        """Keeps a cell; it appears complete or not at all."""
        path = self._path(case, system, "json")
        part = path.with_suffix(".part")
        part.write_text(json.dumps(cell, indent=1) + "\n")
        part.replace(path)

    def keep(self, case: Case, system: str, trajectory: Trajectory) -> None:
        """Keeps a system's trajectory."""
        write_tum(self._path(case, system, "tum"), trajectory)

    def trajectory(self, case: Case, system: str) -> Trajectory | None:
        """The trajectory that was kept, or None."""
        path = self._path(case, system, "tum")
        return read_tum(path) if path.exists() else None

    def _path(self, case: Case, system: str, kind: str) -> Path:
        return self._folder / f"{case.name}.{system}.{kind}"


def compute(case: Case, systems: Iterable[str], store: Store, limits: Limits, say: Callable[[str], None]) -> None:
    """Computes the cells of `case` for `systems` and keeps them. Raises InputError when there is no recording."""
    with tempfile.TemporaryDirectory(prefix="splitslam-accuracy-") as folder:
        work = Path(folder)
        files = prepare(case, work, limits.seconds)
        job = _Job(case, files, work, store, limits)
        for system in systems:
            begun_s = time.monotonic()
            cell = job.cell(system)
            if system not in OURS or not cell["ended"]:  # a run of ours that did not end well is tried again
                store.put(case, system, {"case": case.name, "system": system, **cell})
            say(f"{case.name} {system}: {_summary(cell)} ({time.monotonic() - begun_s:.0f} s)")


class _Job:
    """The systems on one recording, which is dumped for the peers when the first of them needs it."""

    def __init__(self, case: Case, files: Files, work: Path, store: Store, limits: Limits) -> None:
        self._case, self._files, self._work, self._store, self._limits = case, files, work, store, limits
        self._truth = read_tum(files.truth)
        self._dump: Path | None = None
        self._stamps_ns: NDArray[np.int64] | None = None

    def cell(self, system: str) -> Cell:
        if system == SHARPNESS:
            return self._sharpness()
        return self._ours(system) if system in OURS else self._peer(system)

    def _peer(self, system: str) -> Cell:
        run = peers.run_peer(system, self._dumped(), self._work)
        if run.trajectory is not None:
            self._store.keep(self._case, system, scoring.finite(run.trajectory))
        return {"score": self._score(run.trajectory, search=True), "cpu_ms": run.cpu_ms, "ended": run.ended}

    def _ours(self, system: str) -> Cell:
        disable, deskew = OURS[system]
        disable = tuple(dict.fromkeys((*disable, *self._case.drive.disable)))
        run = run_ours(
            self._files, self._work / system, disable=disable, deskew=deskew, max_scans=self._limits.max_scans
        )
        if run.trajectory is None or run.online is None or run.doubt is None:
            return {"score": self._score(None, search=False), "ended": run.ended}
        self._store.keep(self._case, system, run.trajectory)
        doubt = consistency(run.online, run.doubt.covariances, self._truth) if self._files.exact else None
        return {
            "score": self._score(run.trajectory, search=False),
            "online": self._score(run.online, search=False),
            "states": run.doubt.state_shares,
            "nees": None if doubt is None else asdict(doubt),
            **{key: run.report[key] for key in ("jumps", "loops", "gnss_factors", "cpu_ms_per_scan")},
            "ended": "",
        }

    def _sharpness(self) -> Cell:
        scans = read_scans(self._dumped())
        truth = scoring.dense(self._truth)
        maps = []
        for system in _COMPARED:
            trajectory, cell = self._store.trajectory(self._case, system), self._store.get(self._case, system)
            if trajectory is None or cell is None:
                return {"ended": f"needs {system}"}
            maps.append(sharpness.place(scans, trajectory, truth, cell["score"]["offset_ns"]))
        maps.append(sharpness.place(scans, _at(truth, self._stamps()), truth, 0))
        result = sharpness.compare(maps)
        if result is None:
            return {"ended": "no planes that all maps have"}
        return {"cells": result.cells, **dict(zip((*_COMPARED, "truth"), result.thickness_m, strict=True)), "ended": ""}

    def _score(self, trajectory: Trajectory | None, *, search: bool) -> Cell:
        return scoring.score(trajectory, self._truth, self._stamps(), search=search).as_dict()

    def _stamps(self) -> NDArray[np.int64]:
        if self._stamps_ns is None:
            limit = self._limits.max_scans
            self._stamps_ns = scan_stamps_ns(self._files.bag, self._files.robot, max_scans=limit)
        return self._stamps_ns

    def _dumped(self) -> Path:
        if self._dump is None:
            self._dump = self._work / "dump"
            write_dump(self._files.bag, self._files.robot, self._dump, max_scans=self._limits.max_scans)
        return self._dump


def _at(truth: Trajectory, stamps_ns: NDArray[np.int64]) -> Trajectory:
    """The truth itself, as a system that knows it would give it."""
    return interpolate(truth, stamps_ns[(stamps_ns >= truth.stamps_ns[0]) & (stamps_ns <= truth.stamps_ns[-1])])


def _summary(cell: Cell) -> str:
    if cell.get("ended"):
        return cell["ended"]
    if "score" not in cell:
        return ", ".join(f"{key} {value}" for key, value in cell.items() if value != "")
    errors = cell["score"]
    ate = "no figure" if errors["ate_m"] is None else f"ATE {errors['ate_m']:.4f} m"
    return ate + (", failed" if errors["failed"] else "")
