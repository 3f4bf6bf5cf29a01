"""What one robot was answered: each frame once, in order, where the undisturbed drive has it, and how fast."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from splitslam import se3
from splitslam.stack.reel import Reel
from splitslam.wire import session_pb2 as pb

# The same frames give the same poses, so what is allowed is what one numba or CPU may differ from another.
NEAR_M, NEAR_RAD = 0.01, 0.002
_KEPT = 5  # complaints of one robot that are worth reading


@dataclass(slots=True)
class Account:
    """One run of one robot, times in s on one clock: of frame i, when it was due, sent and answered."""

    name: str
    reel: Reel
    due_s: list[float] = field(default_factory=list)
    sent_s: list[float] = field(default_factory=list)
    answered_s: list[float] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)
    finished: pb.Finished | None = None

    def sent(self, due_s: float, now_s: float) -> None:
        """The next frame has left."""
        self.due_s.append(due_s)
        self.sent_s.append(now_s)

    def answer(self, odometry: pb.Odometry, now_s: float) -> None:
        """Takes what the service says of a frame."""
        expected = len(self.answered_s) + 1
        if odometry.seq != expected or odometry.duplicate:
            again = ", a duplicate" if odometry.duplicate else ""
            self.complain(f"answer {expected} is of frame {odometry.seq}{again}")
            return
        self.answered_s.append(now_s)
        if odometry.rejected:
            self.complain(f"frame {odometry.seq} was rejected: {odometry.rejected}")
        elif odometry.stamp_ns != self.reel.frames[odometry.seq - 1].stamp_ns:
            self.complain(f"frame {odometry.seq} was answered with the stamp of another")
        else:
            self._compare(odometry)

    def _compare(self, odometry: pb.Odometry) -> None:
        p = odometry.pose_map_lidar
        T = se3.from_quat(np.array([p.tx_m, p.ty_m, p.tz_m]), np.array([p.qx, p.qy, p.qz, p.qw]))
        off = se3.inv(self.reel.T_map_lidar[odometry.seq - 1]) @ T
        off_m, off_rad = float(np.linalg.norm(off[:3, 3])), se3.angle(off)
        if not (off_m <= NEAR_M and off_rad <= NEAR_RAD):
            self.complain(f"frame {odometry.seq} is {off_m:.3f} m and {off_rad:.4f} rad off the undisturbed drive")

    def end(self, finished: pb.Finished) -> None:
        """The service has closed the session."""
        self.finished = finished
        if finished.mapped != len(self.sent_s):
            self.complain(f"{finished.mapped} of {len(self.sent_s)} frames are mapped at the end")

    def complain(self, text: str) -> None:
        """Something is not as it must be."""
        if len(self.wrong) < _KEPT:
            self.wrong.append(f"{self.name}: {text}")

    @property
    def unanswered(self) -> int:
        """Frames that were sent and never answered."""
        return len(self.sent_s) - len(self.answered_s)

    def answer_ms(self) -> np.ndarray:
        """(answered,) from when each frame was due: a generator or a service that is late hides nothing."""
        count = len(self.answered_s)
        return 1e3 * (np.array(self.answered_s) - np.array(self.due_s[:count]))

    def late_ms(self) -> np.ndarray:
        """(sent,) by how much each frame left after it was due: the generator's own share."""
        return 1e3 * (np.array(self.sent_s) - np.array(self.due_s))
