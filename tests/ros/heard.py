"""What a second process has heard of an agent, held against REP-105 and against the agent's own files."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitslam import se3
from splitslam.tum import Trajectory


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

    def largest_from_m(self, truth: Trajectory, T_body_lidar: NDArray[np.float64]) -> float:
        """How far `map -> odom -> base_link`, second half, leads from where the LiDAR was, laid on the truth where that
        half begins."""
        errors_m = []
        first: NDArray[np.float64] | None = None
        for edges in self.tf[len(self.tf) // 2 :]:
            at = int(np.searchsorted(truth.stamps_ns, edges[0]["stamp_ns"]))
            poses = [se3.from_quat(truth.positions_m[k], truth.quats_xyzw[k]) for k in (at - 1, at)]
            start_ns, end_ns = truth.stamps_ns[at - 1 : at + 1].tolist()
            true = se3.interpolate(poses[0], poses[1], (edges[0]["stamp_ns"] - start_ns) / (end_ns - start_ns))
            T = matrix(edges[0]["pose"]) @ matrix(edges[1]["pose"]) @ T_body_lidar
            first = true @ se3.inv(T) if first is None else first
            errors_m.append(float(np.linalg.norm((first @ T)[:3, 3] - true[:3, 3])))
        assert len(errors_m) > 50
        return max(errors_m)
