"""The agent's files: online.tum, online_covariance.csv, odom.tum, imu.tum, metrics.prom, edge.json: all, or none."""

from __future__ import annotations

import contextlib
import json
import os
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from numpy.typing import NDArray

from edge_agent._text_kernels import LONGEST_LINE, moved_lines
from edge_agent.types import OdometryReply, OdomPoses
from edge_agent.wire import state_name
from splitslam import se3
from splitslam.errors import InputError
from splitslam.tum import tum_line

_UPPER = np.triu_indices(6)
_NUMBERS = ",".join(["%.6e"] * len(_UPPER[0]))

Array = NDArray[np.float64]


class Outputs:
    """Streams to temporary names in `folder`; `publish` renames them, `discard` leaves nothing behind."""

    _NAMES = ("online.tum", "online_covariance.csv", "odom.tum", "imu.tum", "metrics.prom")

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._made = [path for path in (folder, *folder.parents) if not path.exists()]
        self._files: dict[str, TextIO] = {}
        self._text = np.empty(0, np.uint8)  # of a call's IMU-rate poses
        try:
            folder.mkdir(parents=True, exist_ok=True)
            for name in self._NAMES:
                self._files[name] = _temporary(folder, name).open("w", encoding="utf-8")
            self._files["online_covariance.csv"].write(covariance_header())
        except OSError as error:
            self.discard()
            raise InputError(
                f"output.dir {folder}: expected a directory that can be written ({error.strerror})"
            ) from None

    def online(self, reply: OdometryReply) -> None:
        """The answer to a scan as it came, and what it says of its own doubt."""
        self._pose("online.tum", reply.stamp_ns, reply.T_map_lidar)
        self._files["online_covariance.csv"].write(covariance_line(reply))

    def odom(self, stamp_ns: int, T_odom_lidar: Array) -> None:
        """The edge's own pose (4, 4) of a scan."""
        self._pose("odom.tum", stamp_ns, T_odom_lidar)

    def _pose(self, name: str, stamp_ns: int, T: Array) -> None:
        self._files[name].write(tum_line(stamp_ns, T[:3, 3], se3.quat_from_matrix(T[:3, :3])))

    def imu(self, poses: OdomPoses, T_map_odom: Array) -> None:
        """IMU-rate poses, T_map_odom (4, 4) as known at the time."""
        if len(self._text) < LONGEST_LINE * len(poses.stamps_ns):
            self._text = np.empty(LONGEST_LINE * len(poses.stamps_ns), np.uint8)
        size = moved_lines(poses.stamps_ns, poses.positions_m, poses.quats_xyzw, T_map_odom, self._text)
        self._files["imu.tum"].write(self._text[:size].tobytes().decode("ascii"))

    def publish(self, report: dict[str, Any], metrics: str = "") -> None:
        """All files at once under their own names, edge.json last: its presence says that the rest is there.

        metrics: what /metrics has shown last.
        """
        self._files["metrics.prom"].write(metrics)
        for file in self._files.values():
            file.close()
        temporary = _temporary(self._folder, "edge.json")
        temporary.write_text(json.dumps(report, indent=1, allow_nan=False) + "\n")
        for name in (*self._files, "edge.json"):
            os.replace(_temporary(self._folder, name), self._folder / name)
        self._files.clear()

    def discard(self) -> None:
        """After an error: no half-written file, and no directory that was not there before."""
        for file in self._files.values():
            with contextlib.suppress(OSError):  # a full disk: what was to be written goes anyway
                file.close()
        self._files.clear()
        with contextlib.suppress(OSError):  # the folder was never made, or someone else has put something there
            for name in (*self._NAMES, "edge.json"):
                _temporary(self._folder, name).unlink(missing_ok=True)
            for path in self._made:
                path.rmdir()


def covariance_header() -> str:
    """Names of the columns of online_covariance.csv."""
    axes = ("rx", "ry", "rz", "tx", "ty", "tz")
    return ",".join(["stamp_ns", "state", *(f"{axes[i]}_{axes[j]}" for i, j in zip(*_UPPER, strict=True))]) + "\n"


def covariance_line(reply: OdometryReply) -> str:
    """One row: stamp, state by name, upper triangle of the covariance of T_map_lidar row by row (rad and m)."""
    numbers = _NUMBERS % tuple(reply.covariance[_UPPER].tolist())
    return f"{reply.stamp_ns},{state_name(reply.state)},{numbers}\n"


def _temporary(folder: Path, name: str) -> Path:
    return folder / f".{name}.part"
