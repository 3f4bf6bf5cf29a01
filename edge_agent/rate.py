"""Rate control: how many features the next frame may carry, so that the uplink keeps its budget.

Time is the recording's. In every window of 5 s the bytes stay below the budget, and close to it while features are
withheld. Points go before frames: a frame is only left out when not even its motion and a handful of points fit. While
the motion is known well, frames of too few points are worth less than their points put together: some then carry the
motion alone, and the next one carries what they have saved.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from pydantic import Field

from splitslam.config import Model

WINDOW_NS = 5_000_000_000
BYTES_PER_KBIT = 125.0
_LEFT_S = 0.6  # of frames that carry the motion alone: every other frame leaves them room
_MOTION_BYTES = 50  # of a payload without points


class RateSettings(Model):
    """How the budget is used. Shares are of the budget."""

    target: float = Field(default=0.95, gt=0, le=1, description="mean use while features are withheld")
    ceiling: float = Field(default=1.0, gt=0, le=1.1, description="largest use of any window")
    spare: float = Field(
        default=0.05, ge=0, le=0.1, description="beyond the ceiling, for frames with the fewest points"
    )
    largest_frame: float = Field(default=0.15, gt=0, le=1, description="of one window, for one frame")
    largest_first_frame: float = Field(default=0.3, gt=0, le=1, description="the same for those the map begins with")
    backlog_share: float = Field(default=0.7, gt=0, le=1, description="for new frames while old ones wait to be sent")
    horizon_s: float = Field(default=1.5, gt=0, description="in which a window's surplus or lack is evened out")
    worthwhile_points: int = Field(
        default=500, ge=1, description="fewer are put together with the next frame's, where the motion is known well"
    )
    fewest_points: int = Field(default=200, ge=1, description="the same where it is not: fewer do not register")
    fewest_dense_points: int = Field(default=1000, ge=1, description="a keyframe of fewer maps little")
    first_dense_frames: int = Field(
        default=2,
        ge=0,
        description="the map begins with them: whole, if the window allows; a start in motion takes two",
    )
    frame_overhead_bytes: int = Field(
        default=140, ge=0, description="around a payload: envelope, gRPC, HTTP/2, reports"
    )


@dataclass(slots=True)
class _Kind:
    """Running means of one kind of frame, sparse or dense."""

    bare_bytes: float  # of a frame without points
    bytes_per_point: float
    points: float  # if none were withheld
    per_s: float
    fewest: int
    fixed_bytes: float  # mean over all frames: those that carry the motion alone are smaller
    saved_points: int = 0  # allowed to frames that did without

    @property
    def least_bytes(self) -> float:
        """Of a frame with the fewest points."""
        return self.fixed_bytes + min(self.fewest, self.points) * self.bytes_per_point

    @property
    def spare_bytes(self) -> float:
        """What a frame with all its points takes beyond that."""
        return max(self.points - self.fewest, 0.0) * self.bytes_per_point


class RateControl:
    """One uplink's budget. limit_kbps: None for no limit; may change at any time.

    backlog: old frames wait to be sent. withheld_points: so far.
    """

    def __init__(self, settings: RateSettings, limit_kbps: float | None = None) -> None:
        self.settings, self.backlog = settings, False
        self._limit_kbps = limit_kbps
        self.withheld_points = 0
        self._dense_frames = 0
        self._sent: deque[tuple[int, int]] = deque()  # (stamp_ns, bytes) of the last window
        self._sum = 0
        self._unbooked: deque[int] = deque()  # what else went over the link, by whoever sent it
        self._others: deque[tuple[int, int]] = deque()  # the same as _sent
        self._others_sum = 0
        bare = 110.0 + settings.frame_overhead_bytes
        self._kinds = {
            False: _Kind(bare, 2.3, 500.0, 9.0, settings.fewest_points, bare),
            True: _Kind(bare, 1.2, 5000.0, 1.0, settings.fewest_dense_points, bare),
        }
        self._last_ns: int | None = None

    @property
    def limit_kbps(self) -> float | None:
        """The budget. A lower one counts from now on: what was sent under the old one weighs as if under the new."""
        return self._limit_kbps

    @limit_kbps.setter
    def limit_kbps(self, limit_kbps: float | None) -> None:
        before, self._limit_kbps = self._limit_kbps, limit_kbps
        if limit_kbps is None or limit_kbps == before:
            return
        allowed = self._budget() * self.settings.target * WINDOW_NS * 1e-9
        if self._sum > allowed:
            shrink = allowed / self._sum
            self._sent = deque((stamp_ns, int(size * shrink)) for stamp_ns, size in self._sent)
            self._sum = sum(size for _, size in self._sent)

    def admits(self, stamp_ns: int) -> bool:
        """Is there room for a frame at all? If not, the scan is left out before anything is done with it."""
        if self.limit_kbps is None:
            return True
        return self._motion_bytes <= self._room(stamp_ns) + self._spare()

    def points(self, stamp_ns: int, dense: bool, wanted: int, motion_known: bool = False) -> int:
        """How many of the `wanted` points the frame may carry; 0: not enough to be worth it, they are saved up.

        motion_known: well enough that the pose needs no registration yet.
        """
        kind = self._kinds[dense]
        kind.points += 0.3 * (wanted - kind.points)
        if self.limit_kbps is None:
            return wanted
        first = dense and self._dense_frames < self.settings.first_dense_frames
        room = int((self._room_for_points(stamp_ns, first) - kind.bare_bytes) / kind.bytes_per_point)
        if first:
            return max(min(wanted, room), self.settings.fewest_points)
        fewest, share = self._shares(stamp_ns)
        allowed = max(min(int(fewest * kind.fewest + share * (wanted - kind.fewest)), wanted), 0)
        kind.saved_points = min(kind.saved_points + allowed, wanted)
        worth = min(self.settings.worthwhile_points if motion_known and not dense else kind.fewest, wanted)
        points = min(max(kind.saved_points, 0 if motion_known or dense else worth), room)
        if points < worth:
            return 0
        kind.saved_points = 0
        return points

    def fits(self, stamp_ns: int, payload_bytes: int) -> bool:
        """Does an encoded frame fit the window?"""
        if self.limit_kbps is None:
            return True
        return payload_bytes + self.settings.frame_overhead_bytes <= self._room(stamp_ns) + self._spare()

    def sent(self, stamp_ns: int, dense: bool, points: int, wanted: int, payload_bytes: int) -> None:
        """Books a frame."""
        size = payload_bytes + self.settings.frame_overhead_bytes
        self.withheld_points += wanted - points
        self._dense_frames += dense
        self._sent.append((stamp_ns, size))
        self._sum += size
        self._used(stamp_ns)  # forgets what is older: without a budget nobody else asks
        kind = self._kinds[dense]
        if points > 0:
            kind.bytes_per_point += 0.2 * (max(size - kind.bare_bytes, 0.0) / points - kind.bytes_per_point)
        kind.fixed_bytes += 0.1 * ((kind.bare_bytes if points > 0 else size) - kind.fixed_bytes)
        if self._last_ns is not None and stamp_ns > self._last_ns:
            dt = (stamp_ns - self._last_ns) * 1e-9
            for which, other in self._kinds.items():
                other.per_s += min(dt / 3.0, 1.0) * ((which == dense) / dt - other.per_s)
        self._last_ns = stamp_ns

    def _budget(self) -> float:
        """Bytes a second for new frames."""
        assert self._limit_kbps is not None
        return self._limit_kbps * BYTES_PER_KBIT * (self.settings.backlog_share if self.backlog else 1.0)

    def also_sent(self, size: int) -> None:
        """Bytes that are no frame's, from any thread. Frames are planned as without, in what the window has left."""
        if self.limit_kbps is not None:
            self._unbooked.append(size + self.settings.frame_overhead_bytes)

    def _left(self, stamp_ns: int) -> float:
        """Bytes of the window below the ceiling."""
        while self._unbooked:
            size = self._unbooked.popleft()
            self._others.append((stamp_ns, size))
            self._others_sum += size
        while self._others and self._others[0][0] <= stamp_ns - WINDOW_NS:
            self._others_sum -= self._others.popleft()[1]
        window = self._budget() * WINDOW_NS * 1e-9
        return self.settings.ceiling * window - self._used(stamp_ns) - self._others_sum

    def _used(self, stamp_ns: int) -> int:
        while self._sent and self._sent[0][0] <= stamp_ns - WINDOW_NS:
            self._sum -= self._sent.popleft()[1]
        return self._sum

    def _room(self, stamp_ns: int) -> float:
        """Bytes that one frame may take now."""
        window = self._budget() * WINDOW_NS * 1e-9
        return min(self._left(stamp_ns), self.settings.largest_frame * window)

    def _room_for_points(self, stamp_ns: int, first: bool) -> float:
        """The same, when the frames that follow need at least their motion: at a start all of the window's."""
        s, window_s = self.settings, WINDOW_NS * 1e-9
        window = self._budget() * window_s
        rest_s = max(window_s - self._passed_s(stamp_ns), _LEFT_S)
        left = self._left(stamp_ns) - rest_s * self._kinds[False].per_s * self._motion_bytes
        return min(left, (s.largest_first_frame if first else s.largest_frame) * window)

    def _passed_s(self, stamp_ns: int) -> float:
        """Of the window since the run began."""
        return min((stamp_ns - self._sent[0][0]) * 1e-9 if self._sent else 0.0, WINDOW_NS * 1e-9)

    @property
    def _motion_bytes(self) -> float:
        return _MOTION_BYTES + self.settings.frame_overhead_bytes

    def _spare(self) -> float:
        """Bytes beyond the ceiling that the smallest frames may take rather than be left out."""
        return self.settings.spare * self._budget() * WINDOW_NS * 1e-9

    def _shares(self, stamp_ns: int) -> tuple[float, float]:
        """Of the fewest points and of those beyond: what makes frames use the target and evens the window out."""
        s, budget = self.settings, self._budget()
        window_s = WINDOW_NS * 1e-9
        lack = s.target * budget * window_s - self._used(stamp_ns)  # of a whole window; none has passed at a start
        lack -= s.target * budget * (window_s - self._passed_s(stamp_ns))
        rate = s.target * budget + lack / s.horizon_s
        fixed = sum(kind.per_s * kind.fixed_bytes for kind in self._kinds.values())
        least = sum(kind.per_s * kind.least_bytes for kind in self._kinds.values())
        spare = sum(kind.per_s * kind.spare_bytes for kind in self._kinds.values())
        if rate < least:
            return max(rate - fixed, 0.0) / max(least - fixed, 1.0), 0.0
        return 1.0, (rate - least) / max(spare, 1.0)
