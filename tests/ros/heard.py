"""What a second process has heard of an agent, held against REP-105 and against the agent's own files."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitslam import se3
from splitslam.tum import read_tum


def matrix(numbers: list[float]) -> NDArray[np.float64]:
    """x y z qx qy qz qw -> (4, 4)."""
    return se3.from_quat(np.array(numbers[:3]), np.array(numbers[3:]))


@dataclass
class Heard:
    """Messages by topic, in order."""

    tf: list[list[dict[str, Any]]] = field(default_factory=list)
    odometry: list[dict[str, Any]] = field(default_factory=list)
    diagnostics: list[dict[str, Any]] = field(default_factory=list)

    @staticmethod
    def read(text: str) -> Heard:
        heard = Heard()
        for line in text.splitlines():
            message = json.loads(line)
            topic = message.pop("topic")
            if topic == "/tf":
                heard.tf.append(message["transforms"])
            else:
                (heard.diagnostics if topic == "/diagnostics" else heard.odometry).append(message)
        return heard

    def check_tree(self) -> None:
        """`map -> odom -> base_link` in one message with one stamp, which goes on; no other frame, no other owner."""
        assert len(self.tf) > 50
        for edges in self.tf:
            assert [(edge["parent"], edge["child"]) for edge in edges] == [("map", "odom"), ("odom", "base_link")]
            assert edges[0]["stamp_ns"] == edges[1]["stamp_ns"]
        stamps_ns = [edges[0]["stamp_ns"] for edges in self.tf]
        assert (np.diff(stamps_ns) > 0).all()

    def check_odometry(self) -> None:
        """Odometry says what the transforms say, and its speed is that of its poses, in the base."""
        placed = {edges[1]["stamp_ns"]: edges[1]["pose"] for edges in self.tf}
        same = [message for message in self.odometry if message["stamp_ns"] in placed]
        assert len(same) > 50
        for message in same:
            assert (message["parent"], message["child"]) == ("odom", "base_link")
            assert message["pose"] == placed[message["stamp_ns"]]
            assert (np.linalg.eigvalsh(np.array(message["pose_covariance"]).reshape(6, 6)) > 0).all()
        for before, after in zip(self.odometry, self.odometry[1:], strict=False):
            step_s = (after["stamp_ns"] - before["stamp_ns"]) * 1e-9
            if step_s < 0.05:
                step = se3.log(se3.inv(matrix(before["pose"])) @ matrix(after["pose"])) / step_s
                np.testing.assert_allclose(after["twist"], [*step[3:], *step[:3]], atol=1e-6)

    def check_place(self, out: Path, T_body_lidar: NDArray[np.float64]) -> None:
        """`map -> odom -> base_link` leads to where the agent's own file (T_map_lidar at IMU rate) has the LiDAR."""
        own = read_tum(out / "imu.tum")
        row = {stamp_ns: k for k, stamp_ns in enumerate(own.stamps_ns.tolist())}
        assert len(self.tf) > 50
        for edges in self.tf:
            k = row[edges[0]["stamp_ns"]]
            T_map_lidar = matrix(edges[0]["pose"]) @ matrix(edges[1]["pose"]) @ T_body_lidar
            np.testing.assert_allclose(T_map_lidar, se3.from_quat(own.positions_m[k], own.quats_xyzw[k]), atol=1e-6)
