"""Who says where the robot is: the map service, or, while its answers do not come, the edge's own odometry.

The Imu node is given poses of one frame, `steady`, that never jumps. With the service connected, `steady` is the
service's odometry frame (inv(T_map_odom) @ T_map_lidar). In an outage the edge's odometry goes on in it, from the
service's own poses of the last scans; where none has ever come that says where the robot is, from the first scan on,
level: an agent that begins anew in the middle of a run may be looked for, and how it moves meanwhile must not be the
IMU's word alone. Nor that of a robot which the service has lost: after some such answers the edge's odometry goes on
from where the robot was carried to, with a map of its own. When the service is back, its frame lies where the two
disagree by the drift of the outage: T_steady_server. `map` takes that difference, and the robot's `odom` knows nothing
of it.
"""

from __future__ import annotations

from collections import OrderedDict, deque
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from edge_agent.odometry.ring import Ring
from edge_agent.odometry.scan_matching import Outcome, Placement, ScanMatching
from edge_agent.odometry.settings import OdometrySettings
from edge_agent.types import OdometryReply
from splitslam import se3
from splitslam.features import FeatureFrame

Array = NDArray[np.float64]
LOCALISING, LOST, UNANCHORED = 5, 6, 4
_REMEMBERED = 100  # scans: unanswered ones, and placed ones whose late answers can still be used


@dataclass(frozen=True, slots=True)
class Correction:
    """How `map` moved under the robot when the service was back; cause `outage`."""

    translation_m: float
    rotation_rad: float


@dataclass(frozen=True, slots=True)
class OutageReport:
    """Outages so far: how many, how long, and what became of their scans. alone: in one now."""

    alone: bool
    count: int
    seconds: float
    scans: dict[str, int]
    correction_max_m: float


class Outages:
    """Takes every frame that is sent and every answer, and hands out what the Imu node is to be told.

    `alone`: no answers, or from the start none that knows a place; the edge's odometry is at work. Not in lockstep with
    a service, which waits: there an answer is late by two scans only.
    """

    def __init__(
        self, settings: OdometrySettings, redeskew: bool = True, clock_ns: Callable[[], int] | None = None
    ) -> None:
        """clock_ns: by which the age of frames is judged; None: by the newest frame's stamp."""
        self.settings = settings
        self.alone = False
        self.count, self.alone_ns = 0, 0
        self.scans = dict.fromkeys(Outcome, 0)
        self.correction_max_m = 0.0
        self._clock_ns = clock_ns
        self._ring = Ring(settings.keyframes, int(settings.keyframe_s * 1e9), settings.keyframe_points)
        self._matching = ScanMatching(settings, self._ring, redeskew)
        self._unanswered: OrderedDict[int, tuple[int, FeatureFrame]] = OrderedDict()  # by seq; when it was sent
        self._to_place: deque[FeatureFrame] = deque()
        self._placed: OrderedDict[int, Placement] = OrderedDict()  # by seq, in this outage
        self._last: OdometryReply | None = None  # newest answer, with T_map_odom of `steady`
        self._T_steady_server: Array | None = None  # None: no outage so far, they are the same
        self._T_map_steady = np.eye(4)  # when the outage began
        self._joined = 0  # answers that have said so, in this outage
        self._begun_ns = self._newest_ns = 0
        self._anchored = True  # False: the service has not said yet, or not again, where the robot is
        self._known = False  # the service has said once where the robot is
        self._looked_for = 0  # answers in a row that look for a robot that was known
        self._state = UNANCHORED  # of the edge's own poses: that, or what a service says that looks for the robot

    # --- frames -----------------------------------------------------------------------------------------------

    def on_frame(self, frame: FeatureFrame) -> list[OdometryReply]:
        """A frame is sent; what the Imu node is told now. When an outage begins there are some to be placed: they are
        made up for with the next ones."""
        if not self.settings.enabled:
            return []
        now_ns = self._now_ns(frame)
        self._newest_ns = frame.stamp_ns
        self._unanswered[frame.seq] = now_ns, frame
        if len(self._unanswered) > _REMEMBERED:
            self._unanswered.popitem(last=False)
        if self.alone:
            self._to_place.append(frame)
        elif self._is_outage(now_ns):
            self._begin()
        count = min(len(self._to_place), self.settings.scans_at_once)
        return [self._place(self._to_place.popleft()) for _ in range(count)]

    def _now_ns(self, frame: FeatureFrame) -> int:
        return frame.stamp_ns if self._clock_ns is None else self._clock_ns()

    def _is_outage(self, now_ns: int) -> bool:
        if self._is_looked_for and self._can_stand_alone:
            return True
        if len(self._unanswered) < self.settings.unanswered:
            return False
        silent_s = (now_ns - next(iter(self._unanswered.values()))[0]) * 1e-9
        if self._ring.keyframes:
            return silent_s >= self.settings.after_s
        # a service that is just starting is worth waiting for
        return self._knows_nothing and self._can_stand_alone and silent_s >= self.settings.first_after_s

    @property
    def _knows_nothing(self) -> bool:
        """No answer has come that says where the robot is."""
        return self._last is None or self._last.state in (LOCALISING, LOST)

    @property
    def _is_looked_for(self) -> bool:
        """The service answers, but has never known where the robot is, or has not for a while."""
        return self._last is not None and not self._ring.keyframes and self._knows_nothing

    @property
    def _can_stand_alone(self) -> bool:
        return any(self._ring.wants(frame) for _, frame in self._unanswered.values())

    def _begin(self) -> None:
        self._state = UNANCHORED
        if not self._ring.keyframes:
            self._state = self._last.state if self._last is not None else UNANCHORED
            self._stand_alone()
        last = self._last
        assert last is not None
        self.alone, self.count, self._begun_ns = True, self.count + 1, last.stamp_ns
        self._T_map_steady = last.T_map_odom
        T_steady_lidar = se3.inv(last.T_map_odom) @ last.T_map_lidar
        self._matching.start(
            Placement(last.seq, last.stamp_ns, T_steady_lidar, last.covariance, np.zeros((0, 6)), Outcome.PLACED)
        )
        self._joined = 0
        self._to_place.extend(frame for _, frame in self._unanswered.values())

    def _stand_alone(self) -> None:
        """At the oldest dense scan: there `steady`, and `map` until the service says, begin; or, when the robot was
        known, they go on where its motion has carried it since the last answer."""
        last, carried = self._last, np.eye(4)
        while True:
            _, (_, frame) = self._unanswered.popitem(last=False)
            carried = carried @ frame.motion.T_prev_lidar
            if self._ring.wants(frame):
                break
        if last is not None and self._known:
            T_map_odom, covariance = last.T_map_odom, last.covariance
            T = se3.orthonormalised(se3.inv(T_map_odom) @ last.T_map_lidar @ carried)
        else:
            T_map_odom = np.eye(4)
            covariance = np.diag(np.repeat([frame.motion.gravity_sigma_rad**2, 1e-8], 3))
            T = se3.compose(se3.level_rotation(-frame.motion.gravity_lidar), np.zeros(3))
        self._ring.add(frame, T, covariance)
        self._last = OdometryReply(
            frame.seq, frame.stamp_ns, T_map_odom @ T, T_map_odom, covariance, UNANCHORED, np.zeros((0, 6))
        )
        self._anchored = False

    def _place(self, frame: FeatureFrame) -> OdometryReply:
        placement = self._matching.place(frame)
        self.scans[placement.outcome] += 1
        self._placed[frame.seq] = placement
        if len(self._placed) > _REMEMBERED:
            self._placed.popitem(last=False)
        assert self._last is not None
        return OdometryReply(
            seq=frame.seq,
            stamp_ns=frame.stamp_ns,
            T_map_lidar=self._last.T_map_odom @ placement.T_steady_lidar,
            T_map_odom=self._last.T_map_odom,
            covariance=placement.covariance,
            state=self._state,
            degenerate_axes=placement.degenerate_axes,
        )

    # --- answers ----------------------------------------------------------------------------------------------

    def on_answer(self, reply: OdometryReply) -> tuple[OdometryReply | None, Correction | None]:
        """The service's answer as the Imu node is to read it, and how `map` moved if that ends an outage.

        None: in an outage the node is told by the edge's odometry, and by an answer only when the two frames can be
        joined, by a pose of that scan in both. Poses of two frames in turns would be a motion that nobody made.
        """
        looked_for = reply.state in (LOCALISING, LOST)
        if looked_for and not self._ring.keyframes and not reply.rejected:
            if self._known:
                self._take(reply.seq)  # those after it say how the robot was carried on
            self._last = self._steady(reply)  # its frame stays at hand: the edge's odometry may begin there
            return self._last, None
        frame = self._take(reply.seq)
        if reply.rejected:
            return reply, None
        if looked_for:
            self._state = reply.state
        if self.alone:
            return self._late(reply)
        steady = self._last = self._steady(reply)
        self._known |= not looked_for
        if not looked_for:
            self._looked_for = 0
            if frame is not None and self._ring.wants(frame):
                self._ring.add(frame, se3.inv(steady.T_map_odom) @ steady.T_map_lidar, steady.covariance)
        elif self._known:
            self._looked_for += 1
            if self._looked_for >= self.settings.lost_answers:
                self._ring.clear()  # where they lie may be what is wrong
        return steady, None

    def _steady(self, reply: OdometryReply) -> OdometryReply:
        """inv(T_map_odom) @ T_map_lidar of an answer is in the service's frame; of what this returns, in `steady`."""
        if self._T_steady_server is None:
            return reply
        return replace(reply, T_map_odom=reply.T_map_odom @ se3.inv(self._T_steady_server))

    def _take(self, seq: int) -> FeatureFrame | None:
        """The frame that is answered; those before it are settled too."""
        answered = self._unanswered.get(seq)
        while self._unanswered and next(iter(self._unanswered)) <= seq:
            self._unanswered.popitem(last=False)
        return None if answered is None else answered[1]

    def _late(self, reply: OdometryReply) -> tuple[OdometryReply | None, Correction | None]:
        """An answer during an outage: old ones say nothing of now; late ones where `map` is; a fresh one ends it."""
        s, placement = self.settings, self._placed.get(reply.seq)
        age_s = (self._newest_ns - reply.stamp_ns) * 1e-9
        if placement is None or age_s > s.late_s or reply.state in (LOCALISING, LOST):
            return None, None
        self._join(placement, se3.inv(reply.T_map_odom) @ reply.T_map_lidar)
        steady = self._last = self._steady(reply)
        self._known = True
        if age_s > s.back_s:
            return steady, None
        self._end()
        if not self._anchored:  # where the robot was is news, no correction
            self._anchored = True
            return steady, None
        moved = se3.inv(self._T_map_steady @ placement.T_steady_lidar) @ reply.T_map_lidar
        correction = Correction(float(np.linalg.norm(moved[:3, 3])), se3.angle(moved))
        self.correction_max_m = max(self.correction_max_m, correction.translation_m)
        return steady, correction

    def _join(self, placement: Placement, T_server_lidar: Array) -> None:
        """T_steady_server by the two poses of one scan. Both have noise and the drift is slow: a mean of some scans."""
        before, self._joined = self._T_steady_server, self._joined + 1
        expected = placement.T_steady_lidar
        if before is not None and self._joined > 1:
            predicted, gain = before @ T_server_lidar, max(1.0 / self._joined, self.settings.late_gain)
            expected = predicted @ se3.exp(gain * se3.log(se3.inv(predicted) @ expected))
        self._T_steady_server = se3.orthonormalised(expected @ se3.inv(T_server_lidar))

    def _end(self) -> None:
        self.alone, self._looked_for = False, 0
        self.alone_ns += self._newest_ns - self._begun_ns
        self._matching.stop()
        self._to_place.clear()
        self._placed.clear()

    def report(self) -> OutageReport:
        """What there is to say up to now."""
        alone_ns = self.alone_ns + (self._newest_ns - self._begun_ns if self.alone else 0)
        scans = {str(outcome): count for outcome, count in self.scans.items()}
        return OutageReport(self.alone, self.count, alone_ns * 1e-9, scans, self.correction_max_m)
