"""E57 (ASTM E2807): one scan of all points in steps of 0.1 mm, with intensity and time, placed by the scan's pose."""

from __future__ import annotations

import errno
import importlib
import uuid
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from splitslam.errors import InputError
from splitslam.export.gps_time import adjusted_gps_s
from splitslam.export.placing import Placing
from splitslam.maps import MapPiece

STEP_M = 1e-4
_AT_ONCE = 100_000
_REACH = (1 << 31) - 1  # steps: 214 km
_FIELDS = ("cartesianX", "cartesianY", "cartesianZ", "intensity", "timeStamp")


def write_e57_cloud(path: Path, pieces: Iterable[MapPiece], placing: Placing, name: str) -> int:
    """Returns the number of points. The pose of the scan is the offset; WKT is in `coordinateMetadata`.

    Times are those of the keyframes, s after the first. Raises InputError for points too far from the offset, OSError
    when the library could not write.
    """
    lib: Any = importlib.import_module("pye57.libe57")  # compiled, without type information
    image = lib.ImageFile(str(path), "w")
    try:
        count = _Scan(lib, image, placing, name).write(pieces)
        image.close()
    except lib.E57Exception as error:  # as the library reports a disk that fails
        image.cancel()
        raise OSError(errno.EIO, f"E57: {str(error).strip().splitlines()[0]}", str(path)) from error
    except BaseException:
        image.cancel()
        raise
    return count


class _Scan:
    """The file's one scan, its nodes as E57 names them."""

    def __init__(self, lib: Any, image: Any, placing: Placing, name: str) -> None:
        self._lib, self._image, self._placing, self._name = lib, image, placing, name
        self._low, self._high = np.full(3, np.inf), np.full(3, -np.inf)
        self._start_s: float | None = None

    def write(self, pieces: Iterable[MapPiece]) -> int:
        """All points, then what is known only afterwards."""
        lib, image = self._lib, self._image
        scan = self._structure({"guid": _guid(), "name": self._name, "description": self._placing.description})
        self._root(scan)
        reach = -_REACH, _REACH
        prototype = lib.StructureNode(image)
        for field in _FIELDS[:3]:
            prototype.set(field, lib.ScaledIntegerNode(image, 0, *reach, STEP_M, 0.0))
        prototype.set("intensity", lib.IntegerNode(image, 0, 0, 255))
        prototype.set("timeStamp", lib.FloatNode(image, 0.0, lib.E57_DOUBLE, -1e9, 1e9))
        points = lib.CompressedVectorNode(image, prototype, lib.VectorNode(image, True))
        scan.set("points", points)
        arrays = {field: np.empty(_AT_ONCE) for field in _FIELDS}
        buffers = lib.VectorSourceDestBuffer()
        for field, array in arrays.items():
            buffers.append(lib.SourceDestBuffer(image, field, array, _AT_ONCE, True, True))
        writer = points.writer(buffers)
        count = 0
        try:
            for columns in self._blocks(pieces):
                n = columns.shape[1]
                for array, column in zip(arrays.values(), columns, strict=True):
                    array[:n] = column
                writer.write(n)
                count += n
        except BaseException:
            with suppress(lib.E57Exception):  # a writer that outlives its file ends the process
                writer.close()
            raise
        writer.close()
        self._finish(scan, count)
        return count

    def _blocks(self, pieces: Iterable[MapPiece]) -> Iterator[np.ndarray]:
        """(5, n) float64 as in _FIELDS, n at most what the buffers hold."""
        for piece in pieces:
            local = self._placing.place(piece.points_map[:, :3].astype(np.float64)) - self._placing.offset_m
            if not len(local):
                continue
            if not np.abs(local).max() <= _REACH * STEP_M:
                raise InputError(f"keyframe {piece.keyframe}: more than 214 km from the map's origin: too far for E57")
            self._low, self._high = np.minimum(self._low, local.min(axis=0)), np.maximum(self._high, local.max(axis=0))
            time_s = float(adjusted_gps_s(np.array([piece.stamp_ns], np.int64))[0])
            self._start_s = time_s if self._start_s is None else self._start_s
            columns = np.vstack([local.T, piece.points_map[:, 3], np.full(len(local), time_s - self._start_s)])
            for start in range(0, len(local), _AT_ONCE):
                yield columns[:, start : start + _AT_ONCE]

    def _root(self, scan: Any) -> None:
        lib, image, root = self._lib, self._image, self._image.root()
        image.extensionsAdd("", lib.E57_V1_0_URI)
        texts = {"formatName": "ASTM E57 3D Imaging Data File", "guid": _guid()}
        texts |= {"e57LibraryVersion": lib.E57_LIBRARY_ID, "coordinateMetadata": self._placing.wkt}
        for key, text in texts.items():
            root.set(key, lib.StringNode(image, text))
        root.set("versionMajor", lib.IntegerNode(image, lib.E57_FORMAT_MAJOR))
        root.set("versionMinor", lib.IntegerNode(image, lib.E57_FORMAT_MINOR))
        data3d = lib.VectorNode(image, True)
        root.set("data3D", data3d)
        root.set("images2D", lib.VectorNode(image, True))
        data3d.append(scan)

    def _finish(self, scan: Any, count: int) -> None:
        offset = self._placing.offset_m
        low, high = (self._low, self._high) if count else (np.zeros(3), np.zeros(3))
        bounds = {f"{axis}{end}": float(v[i]) for end, v in (("Minimum", low), ("Maximum", high))
                  for i, axis in enumerate("xyz")}  # fmt: skip
        scan.set("cartesianBounds", self._structure(bounds))
        scan.set("intensityLimits", self._structure({"intensityMinimum": 0, "intensityMaximum": 255}))
        rotation = self._structure({"w": 1.0, "x": 0.0, "y": 0.0, "z": 0.0})
        translation = self._structure(dict(zip("xyz", offset.tolist(), strict=True)))
        pose = self._lib.StructureNode(self._image)
        pose.set("rotation", rotation)
        pose.set("translation", translation)
        scan.set("pose", pose)
        if self._start_s is not None:
            start = {"dateTimeValue": self._start_s + 1e9, "isAtomicClockReferenced": 0}
            scan.set("acquisitionStart", self._structure(start))

    def _structure(self, values: Mapping[str, str | float | int]) -> Any:
        node = self._lib.StructureNode(self._image)
        for key, value in values.items():
            kind = {str: "StringNode", int: "IntegerNode", float: "FloatNode"}[type(value)]
            node.set(key, getattr(self._lib, kind)(self._image, value))
        return node


def _guid() -> str:
    return f"{{{uuid.uuid4()}}}"
