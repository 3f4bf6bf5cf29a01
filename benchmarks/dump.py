"""A recording as plain arrays on disk, for programs in another environment that do not have our packages.

Every system must see the same input: scans and IMU samples come through our readers and sequencer, with the same range
gate, per-point times as they are (not snapped to columns), and messages with bad stamps left out.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge_agent.sources import Recording, Sequencer, open_recording
from splitslam.robot import Robot, load_robot
from splitslam.scan import ImuSamples, Scan, ScanPacket

# x y z: m, frame `lidar` at the point's own time; t: ns after the scan's stamp; row: ring number.
POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("t", "<u4"), ("row", "<u2")])
# begin, end: the scan's rows of points.bin.
SCAN = np.dtype([("stamp_ns", "<i8"), ("end_ns", "<i8"), ("begin", "<i8"), ("end", "<i8")])
SAMPLE = np.dtype([("stamp_ns", "<i8"), ("gyro_radps", "<f8", 3), ("accel_mps2", "<f8", 3)])


def write_dump(recording: Path, robot: Path, folder: Path, *, max_scans: int | None = None) -> int:
    """Writes sensors.json, points.bin (POINT), scans.npy (SCAN), imu.npy (SAMPLE) into `folder`; returns the scans.

    Raises InputError for a recording or robot file that cannot be used.
    """
    folder.mkdir(parents=True, exist_ok=True)
    scans: list[tuple[int, int, int, int]] = []
    samples = [np.empty(0, SAMPLE)]
    written = 0
    with (
        open_recording(recording, load_robot(robot), max_scans=max_scans) as source,
        (folder / "points.bin").open("wb") as file,
    ):
        for item in _released(source):
            if isinstance(item, ImuSamples):
                samples.append(_samples(item))
                continue
            _points(item.scan).tofile(file)
            scans.append((item.scan.stamp_ns, item.scan.end_ns, written, written + len(item.scan)))
            written += len(item.scan)
        sensors = _sensors(source.robot)
    np.save(folder / "scans.npy", np.array(scans, SCAN))
    np.save(folder / "imu.npy", np.concatenate(samples))
    (folder / "sensors.json").write_text(json.dumps(sensors, indent=1) + "\n")
    return len(scans)


def scan_stamps_ns(recording: Path, robot: Path, *, max_scans: int | None = None) -> NDArray[np.int64]:
    """(N,) int64, the stamps of the scans that a system should have a pose for. Raises InputError."""
    with open_recording(recording, load_robot(robot), max_scans=max_scans) as source:
        stamps = [item.scan.stamp_ns for item in _released(source) if isinstance(item, ScanPacket)]
    return np.array(stamps, np.int64)


def read_scans(folder: Path) -> list[tuple[int, NDArray[np.float64], NDArray[np.int64]]]:
    """A dump's scans: (stamp_ns, points (N, 3) m at their own times, times after the stamp (N,) ns)."""
    points = np.memmap(folder / "points.bin", POINT, "r")
    out = []
    for row in np.load(folder / "scans.npy"):
        part = points[row["begin"] : row["end"]]
        xyz = np.stack([part[name] for name in "xyz"], axis=1).astype(np.float64)
        out.append((int(row["stamp_ns"]), xyz, part["t"].astype(np.int64)))
    return out


def _released(source: Recording) -> Iterator[ImuSamples | ScanPacket]:
    """Scans and IMU samples in the sequencer's order; no peer takes more."""
    sequencer = Sequencer(source.robot)
    pushed = chain.from_iterable(sequencer.push(event) for _, event in source.events())
    for item in chain(pushed, _finish(sequencer)):
        if isinstance(item, ImuSamples | ScanPacket):
            yield item


def _finish(sequencer: Sequencer) -> Iterator[object]:
    yield from sequencer.finish()  # asked only when the events have ended


def _points(scan: Scan) -> np.ndarray:
    points = np.empty(len(scan), POINT)
    for column, name in enumerate("xyz"):
        points[name] = scan.points_lidar[:, column]
    points["intensity"], points["t"], points["row"] = scan.intensity, scan.t_offset_ns, scan.ring
    return points


def _samples(samples: ImuSamples) -> np.ndarray:
    rows = np.empty(len(samples), SAMPLE)
    rows["stamp_ns"] = samples.stamps_ns
    rows["gyro_radps"], rows["accel_mps2"] = samples.gyro_radps, samples.accel_mps2
    return rows


def _sensors(robot: Robot) -> dict[str, Any]:
    """What a system is told about the sensors: the robot file's own figures, the same for all."""
    imu = None if robot.imu is None else robot.imu.model_dump(mode="json")
    return {
        "lidar": robot.lidar.model_dump(mode="json"),
        "imu": imu,
        "T_lidar_imu": robot.T_lidar_imu.tolist(),
        "gravity_mps2": robot.gravity_mps2,
    }
