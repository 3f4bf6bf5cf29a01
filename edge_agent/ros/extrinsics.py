"""Where the sensors are, by /tf_static, for what the robot file does not say."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge_agent.ros.tf_buffer import TfBuffer
from splitslam.errors import InputError
from splitslam.robot import Robot


@dataclass(slots=True)
class Extrinsics:
    """Completes a robot file. frames: section -> frame of its messages (wheels: `child_frame_id`), those known.

    wait: until more transforms have come; False when there is no more time.
    """

    tree: TfBuffer
    base_frame: str
    frames: Mapping[str, str]
    wait: Callable[[], bool]
    name: str
    notes: list[str] = field(default_factory=list)

    def complete(self, robot: Robot) -> Robot:
        """The robot with its places filled in. Raises InputError when that of the IMU is nowhere to be found."""
        update: dict[str, Any] = {}
        if "T_body_lidar" not in robot.model_fields_set:
            T = self._find("T_body_lidar", self.base_frame, self.frames["lidar"])
            if T is not None:
                update["T_body_lidar"] = T
        if robot.imu is not None and not robot.imu_placed:
            update["T_lidar_imu"] = self._imu()
        if robot.gnss is not None and "t_lidar_antenna_m" not in robot.gnss.model_fields_set:
            T = self._find("gnss.t_lidar_antenna_m", self.frames["lidar"], self.frames.get("gnss"))
            if T is not None:
                update["gnss"] = robot.gnss.model_copy(update={"t_lidar_antenna_m": tuple(T[:3, 3].tolist())})
        if robot.wheels is not None and "T_body_wheel" not in robot.wheels.model_fields_set:
            T = self._find("wheels.T_body_wheel", self.base_frame, self.frames.get("wheels"))
            if T is not None:
                update["wheels"] = robot.wheels.model_copy(update={"T_body_wheel": T})
        return robot.model_copy(update=update)

    def _imu(self) -> NDArray[np.float64]:
        T = self._find("T_lidar_imu", self.frames["lidar"], self.frames.get("imu"))
        if T is None:
            between = f"{self.frames['lidar']} and {self.frames.get('imu', 'that of the IMU, which is silent')}"
            raise InputError(
                f"{self.name}: T_lidar_imu: must be given: it is not in the robot file, and /tf_static does not connect"
                f" the frames {between} (or set imu: null)"
            )
        return T

    def _find(self, key: str, target: str, source: str | None) -> NDArray[np.float64] | None:
        """T_target_source; None, and a note, when nobody says it."""
        if source is None:
            self.notes.append(f"{key}: nothing has come yet, so its frame is not known: as in the robot file")
            return None
        T = np.eye(4) if source == target else self.tree.lookup(target, source)
        while T is None and self.wait():
            T = self.tree.lookup(target, source)
        if T is None:
            self.notes.append(f"{key}: /tf_static does not connect {target} and {source}: as in the robot file")
        else:
            self.notes.append(f"{key}: {target} <- {source}, by /tf_static")
            T.setflags(write=False)
        return T
