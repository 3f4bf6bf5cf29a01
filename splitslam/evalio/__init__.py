"""This system as a pipeline of the evalio benchmark: evalio -M splitslam.evalio run -p splitslam -d DATASET/SEQUENCE

What evalio gets are the poses as they were answered, T_map_imu: it has no end at which optimised ones could be told.
"""

# pyright: reportMissingImports=false, reportAttributeAccessIssue=false, reportUntypedBaseClass=false
from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
from evalio import types
from evalio.pipelines import Pipeline
from numpy.typing import NDArray

from edge_agent.sources.beams import estimate_per_ring
from edge_agent.sources.raw import Gate, RawScan
from splitslam import __version__
from splitslam.errors import DataError, InputError
from splitslam.evalio.system import System
from splitslam.robot import Robot
from splitslam.scan import ImuSamples

FIRST_SCANS = 5  # the elevations of the rings are taken from
_PARAMETERS: dict[str, bool | int | float | str] = {"loops": True, "max_kbps": 0.0}


class SplitSlam(Pipeline):
    """loops: loop closure. max_kbps: uplink budget the features are chosen for; 0: none."""

    def __init__(self) -> None:
        super().__init__()
        self._parameters = dict(_PARAMETERS)
        self._sections: dict[str, Any] = {"gnss": None}
        self._T_imu_lidar = np.eye(4)
        self._waiting: list[RawScan | ImuSamples] = []  # until the rings are known
        self._system: System | None = None
        self._robot, self._gate = Robot(imu=None), Gate(Robot(imu=None), Counter())
        self.left_out: Counter[str] = Counter()  # scans, and points of those that were not, by reason

    # -- what it is ---------------------------------------------------------------------------------------------

    @staticmethod
    def name() -> str:
        return "splitslam"

    @staticmethod
    def version() -> str:
        return __version__

    @staticmethod
    def url() -> str:
        return ""

    @staticmethod
    def default_params() -> dict[str, bool | int | float | str]:
        return dict(_PARAMETERS)

    # -- before the first measurement ---------------------------------------------------------------------------

    def set_params(self, params: dict[str, Any]) -> dict[str, Any]:
        """Returns those that it does not know."""
        self._parameters |= {key: value for key, value in params.items() if key in _PARAMETERS}
        return {key: value for key, value in params.items() if key not in _PARAMETERS}

    def set_imu_params(self, params: types.ImuParams) -> None:
        self._sections["gravity_mps2"] = float(np.linalg.norm(params.gravity))
        self._sections["imu"] = {
            "rate_hz": params.rate,
            "gyro_noise_radps_rthz": params.gyro,
            "accel_noise_mps2_rthz": params.accel,
            "gyro_walk_radps2_rthz": params.gyro_bias,
            "accel_walk_mps3_rthz": params.accel_bias,
        }

    def set_lidar_params(self, params: types.LidarParams) -> None:
        self._sections["lidar"] = {
            "rings": params.num_rows,
            "columns": params.num_columns,
            "rate_hz": params.rate,
            "min_range_m": params.min_range,
            "max_range_m": params.max_range,
        }

    def set_imu_T_lidar(self, T: types.SE3) -> None:
        self._T_imu_lidar = T.to_mat()
        self._sections["T_lidar_imu"] = np.linalg.inv(self._T_imu_lidar).tolist()

    def initialize(self) -> None:
        """Raises InputError for sensors that cannot be used."""
        try:
            self._robot = Robot(**self._sections)
        except ValueError as error:
            raise InputError(f"evalio: sensors: {error}") from error
        self._gate = Gate(self._robot, self.left_out)

    # -- measurements -------------------------------------------------------------------------------------------

    def add_imu(self, mm: types.ImuMeasurement) -> None:
        stamp_ns = np.array([mm.stamp.to_nsec()])
        self._add(ImuSamples(stamp_ns, np.array(mm.gyro).reshape(1, 3), np.array(mm.accel).reshape(1, 3)))

    def add_lidar(self, mm: types.LidarMeasurement) -> None:
        """A scan of which nothing can be used is counted and left out."""
        points = [(p.x, p.y, p.z, p.intensity, p.t.to_nsec(), p.row) for p in mm.points]
        try:
            self._add(raw_scan(mm.stamp.to_nsec(), np.array(points, float).reshape(-1, 6)))
        except DataError as error:
            self.left_out[error.reason] += 1

    def _add(self, measurement: RawScan | ImuSamples) -> None:
        self._waiting.append(measurement)
        if self._system is None and not self._begin():
            return
        assert self._system is not None
        waiting, self._waiting = self._waiting, []
        for one in waiting:
            try:
                self._system.push(self._gate(one) if isinstance(one, RawScan) else one)
            except DataError as error:
                self.left_out[error.reason] += 1
        for answer in self._system.take_answers():
            T_map_imu = answer.T_map_lidar @ self._robot.T_lidar_imu
            self.save(types.Stamp.from_nsec(answer.stamp_ns), types.SE3.from_mat(T_map_imu))

    def _begin(self) -> bool:
        """Once there are scans enough to know the rings by."""
        scans = [one for one in self._waiting if isinstance(one, RawScan)]
        if len(scans) < FIRST_SCANS:
            return False
        clouds = [(scan.points_lidar, scan.ring) for scan in scans]
        beams = estimate_per_ring(clouds, self._robot.lidar.rings)
        if beams is None:  # in front of a wall: the next scans may show more
            return False
        limit_kbps = float(self._parameters["max_kbps"]) or None
        self._system = System(self._robot, beams, loops=bool(self._parameters["loops"]), max_kbps=limit_kbps)
        return True

    def map(self) -> dict[str, list[types.Point]]:
        """Where the keyframes are: for evalio's viewer."""
        positions = np.zeros((0, 3)) if self._system is None else self._system.map.graph.poses.positions_m
        return {"keyframes": [types.Point(x=x, y=y, z=z) for x, y, z in positions.tolist()]}


def raw_scan(stamp_ns: int, points: NDArray[np.float64]) -> RawScan:
    """points: (N, 6) x y z in m, intensity, time after the stamp in ns, row; empty cells are at 0.

    Raises DataError for a scan without a point.
    """
    seen = points[np.isfinite(points).all(axis=1) & points[:, :3].any(axis=1)]
    if not len(seen):
        raise DataError("empty")
    times_ns = seen[:, 4].astype(np.int64)
    first_ns = int(times_ns.min())
    return RawScan(
        stamp_ns=stamp_ns + first_ns,
        end_ns=stamp_ns + int(times_ns.max()),
        points_lidar=seen[:, :3].astype(np.float32),
        t_offset_ns=times_ns - first_ns,
        ring=seen[:, 5].astype(np.int64),
        intensity=np.clip(seen[:, 3], 0, 255).astype(np.uint8),
    )
