"""The robot file: the one description of a robot's sensors (format: docs/conventions.md)."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pydantic
import yaml
from numpy.typing import NDArray

from splitslam import config
from splitslam.config import Model
from splitslam.errors import InputError

AUTO = "auto"  # a topic that is looked for under the usual names
_RIGID_TOLERANCE = 1e-3  # people write four digits
_MODEL_SHAPE = {  # rings, columns of one turn at 10 Hz
    "vlp16": (16, 1800),
    "hdl32": (32, 2170),
    "hdl64": (64, 2083),
    "ouster": (64, 1024),
    "hesai": (32, 2000),
    "generic": (16, 1800),
}


def _rigid(value: Any) -> NDArray[np.float64]:
    """Four rows of four numbers -> checked (4, 4) float64, rotation made exactly orthonormal, read-only."""
    try:
        T = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError("expected four rows of four numbers") from None
    if T.shape != (4, 4):
        raise ValueError(f"expected four rows of four numbers, found shape {T.shape}")
    if not np.isfinite(T).all():
        raise ValueError("not a rigid transform: not all numbers are finite")
    R = T[:3, :3]
    error = float(np.abs(R.T @ R - np.eye(3)).max())
    if not np.array_equal(T[3], [0.0, 0.0, 0.0, 1.0]):
        raise ValueError(f"not a rigid transform: last row must be [0, 0, 0, 1], found {T[3].tolist()}")
    if error > _RIGID_TOLERANCE:
        raise ValueError(f"not a rigid transform: R^T R differs from identity by {error:.2g}, at most 0.001 expected")
    if np.linalg.det(R) < 0:
        raise ValueError("not a rigid transform: determinant is -1 (a reflection), expected a rotation")
    if error > 1e-12:
        U, _, Vt = np.linalg.svd(R)
        T[:3, :3] = U @ Vt
    T.setflags(write=False)
    return T


Transform = Annotated[
    np.ndarray,
    pydantic.BeforeValidator(_rigid),
    pydantic.PlainSerializer(lambda T: [[float(v) for v in row] for row in T], return_type=list),
]
Box = tuple[float, float, float, float, float, float]
Positive = Annotated[float, pydantic.Field(gt=0, allow_inf_nan=False)]


class Identity(Model):
    """Who the robot is."""

    id: Annotated[str, pydantic.Field(min_length=1, max_length=128, pattern=r"^[A-Za-z0-9._-]+$")] = "robot"


class Lidar(Model):
    """One spinning LiDAR. Elevations are indexed by ring number; boxes are cut out in frame `body`.

    point_times: what the times of points are worth. `given`: taken as they are; `mirrored`: they run against the sense
    in which the sensor turns, from the scan's last firing to its first; `one_moment`: the points are deskewed already.
    """

    model: Literal["vlp16", "hdl32", "hdl64", "ouster", "hesai", "generic"] = "generic"
    topic: str = AUTO
    stamp: Literal["start", "end"] = "start"
    point_times: Literal["given", "mirrored", "one_moment"] = "given"
    rings: Annotated[int, pydantic.Field(ge=1, le=256)] = 16
    columns: Annotated[int, pydantic.Field(ge=16, le=8192)] = 1800
    rate_hz: Positive = 10.0
    min_range_m: Annotated[float, pydantic.Field(ge=0, allow_inf_nan=False)] = 0.8
    max_range_m: Positive = 100.0
    beam_elevations_deg: tuple[float, ...] | None = None
    metadata: Path | None = None
    crop_boxes_body: tuple[Box, ...] = ()

    @pydantic.model_validator(mode="before")
    @classmethod
    def _shape_of_model(cls, data: Any) -> Any:
        if isinstance(data, dict) and data.get("model", "generic") in _MODEL_SHAPE:
            rings, columns = _MODEL_SHAPE[data.get("model", "generic")]
            beams = data.get("beam_elevations_deg")
            data = {"rings": len(beams) if isinstance(beams, list) and beams else rings, "columns": columns, **data}
        return data

    @pydantic.field_validator("beam_elevations_deg")
    @classmethod
    def _elevations_are_angles(cls, value: tuple[float, ...] | None) -> tuple[float, ...] | None:
        if value is not None and not all(-90.0 <= angle <= 90.0 for angle in value):
            raise ValueError("expected degrees between -90 and 90")
        return value

    @pydantic.model_validator(mode="after")
    def _consistent(self) -> Lidar:
        if self.beam_elevations_deg is not None and len(self.beam_elevations_deg) != self.rings:
            raise ValueError(
                f"beam_elevations_deg has {len(self.beam_elevations_deg)} values, expected rings = {self.rings}"
            )
        if self.min_range_m >= self.max_range_m:
            raise ValueError(f"min_range_m {self.min_range_m} must be below max_range_m {self.max_range_m}")
        for box in self.crop_boxes_body:
            if any(low >= high for low, high in zip(box[:3], box[3:], strict=True)):
                raise ValueError(f"crop_boxes_body: expected [xmin, ymin, zmin, xmax, ymax, zmax], found {list(box)}")
        return self


class Imu(Model):
    """One IMU; `time_offset_ns` is added to its stamps. Noise densities are continuous-time."""

    topic: str | None = AUTO
    rate_hz: Positive = 100.0
    time_offset_ns: int = 0
    gyro_noise_radps_rthz: Positive = 1.2e-4
    accel_noise_mps2_rthz: Positive = 2.5e-4
    gyro_walk_radps2_rthz: Positive = 2.0e-5
    accel_walk_mps3_rthz: Positive = 2.0e-4


class Gnss(Model):
    """One GNSS receiver; the antenna's place in frame `lidar`."""

    topic: str | None = AUTO
    t_lidar_antenna_m: tuple[float, float, float] = (0.0, 0.0, 0.0)


class Wheels(Model):
    """Wheel odometry, taken from the twist alone; `time_offset_ns` is added to its stamps.

    T_body_wheel: where the twist's frame (its `child_frame_id`) is. holonomic: the base can drive sideways, its y
    velocity is measured; otherwise only `sideways_mps` is known of it, and of the vertical velocity in any case.
    scale: standard deviation of the relative error of the speed (tyres, track), which the graph then estimates.
    """

    model_config = pydantic.ConfigDict(arbitrary_types_allowed=True)

    topic: str | None = AUTO
    rate_hz: Positive = 50.0
    time_offset_ns: int = 0
    T_body_wheel: Transform = pydantic.Field(default_factory=lambda: _rigid(np.eye(4)))
    holonomic: bool = False
    speed_noise_mps: Positive = 0.05
    scale: Positive = 0.02
    sideways_mps: Positive = 0.1


class Robot(Model):
    """The whole file. `imu`, `gnss` or `wheels` is None when the robot has none (section or its topic null).

    Wheels are used only when the file has the section: a topic of their type may be another program's pose.
    """

    model_config = pydantic.ConfigDict(arbitrary_types_allowed=True)

    robot: Identity = Identity()
    lidar: Lidar = Lidar()
    imu: Imu | None = Imu()
    gnss: Gnss | None = Gnss()
    wheels: Wheels | None = None
    T_lidar_imu: Transform = pydantic.Field(default_factory=lambda: _rigid(np.eye(4)))
    T_body_lidar: Transform = pydantic.Field(default_factory=lambda: _rigid(np.eye(4)))
    gravity_mps2: Annotated[float, pydantic.Field(gt=9.0, lt=10.5)] = 9.80665

    @pydantic.model_validator(mode="before")
    @classmethod
    def _null_topic_is_no_sensor(cls, data: Any) -> Any:
        if not isinstance(data, dict):
            return data
        data = dict(data)
        for section in ("imu", "gnss", "wheels"):
            given = data.get(section)
            if isinstance(given, dict) and "topic" in given and given["topic"] is None:
                data[section] = None
        if data.get("T_lidar_imu", 0) is None:
            del data["T_lidar_imu"]
        return data

    @pydantic.model_validator(mode="after")
    def _imu_needs_its_place(self) -> Robot:
        if self.imu is not None and self.imu.topic != AUTO and not self.imu_placed:
            raise ValueError("T_lidar_imu: must be given when there is an IMU (p_lidar = T_lidar_imu @ p_imu)")
        return self

    @property
    def imu_placed(self) -> bool:
        """True when the file gives T_lidar_imu."""
        return "T_lidar_imu" in self.model_fields_set

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Robot) and robot_to_yaml(self) == robot_to_yaml(other)

    def __hash__(self) -> int:
        return hash(robot_to_yaml(self))


def load_robot(path: Path, placed_elsewhere: bool = False) -> Robot:
    """Reads a robot file; `lidar.metadata` is looked for beside it. InputError: one line, file, key, expectation.

    placed_elsewhere: a missing T_lidar_imu is no mistake: somebody else may know it.
    """
    data = config.parse_yaml(config.read_text(path), str(path))
    lidar = data.get("lidar")
    if isinstance(lidar, dict) and isinstance(lidar.get("metadata"), str):
        metadata = path.parent / lidar["metadata"]
        data["lidar"] = {**_from_metadata(metadata), **lidar, "metadata": str(metadata)}
    imu = data.get("imu")
    if placed_elsewhere and isinstance(imu, dict) and imu.get("topic") is not None and not data.get("T_lidar_imu"):
        topic = config.validate(Imu, imu, str(path)).topic
        robot = config.validate(Robot, data | {"imu": {k: v for k, v in imu.items() if k != "topic"}}, str(path))
        return robot.model_copy(update={"imu": robot.imu and robot.imu.model_copy(update={"topic": topic})})
    return config.validate(Robot, data, str(path))


def robot_from_yaml(text: str, name: str = "robot file") -> Robot:
    """The same from text (as it travels in Hello); metadata is not read again, its values are in the text."""
    return config.validate(Robot, config.parse_yaml(text, name), name)


def robot_to_yaml(robot: Robot) -> str:
    """YAML with every default filled in, except a T_lidar_imu that nobody gave."""
    return _as_yaml(robot, _written(robot))


def robot_for_service(robot: Robot) -> str:
    """The same without what only the edge uses: a map service of 0.1.0 refuses `wheels` as unknown, one of 0.2.0
    `lidar.point_times`."""
    return _as_yaml(robot, _written(robot) - {"wheels"}, {"lidar": {"point_times"}})


def _written(robot: Robot) -> set[str]:
    return set(Robot.model_fields) - (set() if robot.imu_placed else {"T_lidar_imu"})


def _as_yaml(robot: Robot, sections: set[str], without: dict[str, set[str]] | None = None) -> str:
    data = robot.model_dump(mode="json", include=sections, exclude=without)
    return yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=120)


def _from_metadata(path: Path) -> dict[str, Any]:
    """Rings, columns and beam elevations out of an Ouster metadata JSON, old flat or new nested."""
    try:
        data = json.loads(config.read_text(path))
        beams = data.get("beam_intrinsics", data)["beam_altitude_angles"]
        data_format = data.get("lidar_data_format", data.get("data_format"))
        columns = data_format["columns_per_frame"] if data_format else int(data["lidar_mode"].split("x")[0])
        angles = [float(np.mean(angle)) for angle in beams]
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise InputError(f"{path}: not Ouster metadata: expected JSON with beam_altitude_angles") from error
    return {"rings": len(angles), "columns": int(columns), "beam_elevations_deg": angles}
