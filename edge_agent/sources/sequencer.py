"""Releases a scan only when the IMU covers its end, and lets no bad time into a run."""

from __future__ import annotations

import logging
from collections import Counter, deque
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from edge_agent.sources._kernels import all_within, goes_on
from edge_agent.sources.stream_clock import JUMP_NS, StreamClock
from edge_agent.sources.time_map import TimeMap
from splitslam.logs import fields
from splitslam.robot import Robot
from splitslam.scan import GnssFix, ImuSamples, Scan, ScanPacket, WheelSamples

_MAX_WAITING = 20
# What is beyond is no measurement, and one of it would throw `odom` away for good: 5,700 deg/s, 100 g.
_MOST_RADPS, _MOST_MPS2 = 100.0, 1000.0
_MOST_M = float(np.finfo(np.float32).max)  # of a point: all but NaN and infinity
_log = logging.getLogger(__name__)
Item = ImuSamples | WheelSamples | ScanPacket


class Sequencer:
    """Merges scans, IMU samples, wheel odometry and GNSS fixes into what the pipeline takes, in order.

    Out come IMU samples as they arrive, and each scan right after the first sample at or after its end; a chunk of
    samples is split there. Wheel odometry passes as it comes, fixes go with the next packet. Without an IMU a scan
    passes straight through.
    dropped: messages left out by reason: duplicate, time_backwards, time_jump, nan, empty; with the prefix `imu_`,
    `wheel_` or `gnss_` for those streams; imu_range.
    uncovered: scans released without the IMU reaching their end: it has stopped, or the input has ended. A scan
    waits for it until 20 do; then none does, until it is back. Samples for the time of a scan that is gone are dropped.
    times: steps of the sensors' clocks, which do not reach the run.
    """

    def __init__(self, robot: Robot) -> None:
        self.dropped: Counter[str] = Counter()
        self.uncovered = 0
        self._imu = robot.imu is not None
        self._covered_ns: int | None = None
        self._silent = False  # the IMU: nobody waits for it until it is back
        self._waiting: deque[tuple[Scan, int | None]] = deque()  # and when they came
        self._fixes: list[GnssFix] = []
        self.times = TimeMap()
        self._scan_clock = StreamClock[Scan]("lidar", "", self.dropped, self.times)
        self._imu_clock = StreamClock[ImuSamples]("imu", "imu_", self.dropped, self.times)
        self._wheel_clock = StreamClock[WheelSamples]("wheels", "wheel_", self.dropped, self.times)
        self._gnss_clock = StreamClock[GnssFix]("gnss", "gnss_", self.dropped, self.times)

    @property
    def offset_ns(self) -> int:
        """What the time of the run is ahead of the sensors' own, after their clock has stepped."""
        return (self._imu_clock if self._imu else self._scan_clock).offset_ns

    def push(self, event: Scan | ImuSamples | WheelSamples | GnssFix, arrival_ns: int | None = None) -> list[Item]:
        """Takes one message; returns what may go to the pipeline now. arrival_ns: when it came, on a steady clock."""
        if isinstance(event, ImuSamples):
            return self._push_imu(event, arrival_ns)
        if isinstance(event, WheelSamples):
            return [*self._wheel_clock.admit(int(event.stamps_ns[0]), int(event.stamps_ns[-1]), event, arrival_ns)]
        if isinstance(event, GnssFix):
            self._fixes.extend(self._gnss_clock.admit(event.stamp_ns, event.stamp_ns, event, arrival_ns))
            return []
        return self._push_scan(event, arrival_ns)

    def push_imu(self, samples: ImuSamples, arrivals_ns: Sequence[int]) -> list[Item]:
        """The same as one `push` for each of the samples, cheaper where time simply goes on in them."""
        if self._goes_on(samples) and _is_usable(samples):
            passed = self._imu_clock.admit_run(samples.stamps_ns.tolist(), samples, arrivals_ns)
            return self._emit(passed)
        out: list[Item] = []
        for k, arrival_ns in enumerate(arrivals_ns):
            out += self._push_imu(_slice(samples, k, k + 1), arrival_ns)
        return out

    def finish(self) -> list[Item]:
        """End of input: everything that still waits."""
        out: list[Item] = [*self._wheel_clock.flush()]
        for samples in self._imu_clock.flush():
            out.extend(self._emit(samples))
        self._waiting.extend((scan, None) for scan in self._scan_clock.flush())
        while self._waiting:
            out.append(self._release())
        return out

    def _push_scan(self, scan: Scan, arrival_ns: int | None) -> list[Item]:
        if len(scan) == 0:
            self.dropped["empty"] += 1
            return []
        if not all_within(scan.points_lidar, _MOST_M):
            self.dropped["nan"] += 1
            return []
        passed = self._scan_clock.admit(scan.stamp_ns, scan.stamp_ns, scan, arrival_ns)
        self._waiting.extend((scan, arrival_ns) for scan in passed)
        out: list[Item] = []
        if len(self._waiting) > _MAX_WAITING and not self._silent:
            self._silent = True
            _log.warning("imu silent, going on without it", extra=fields(scans=_MAX_WAITING))
        while self._waiting and (self._silent or self._covers(self._waiting[0][0])):
            out.append(self._release())
        return out

    def _push_imu(self, samples: ImuSamples, arrival_ns: int | None) -> list[Item]:
        out: list[Item] = []
        if not _is_usable(samples):
            samples = self._usable(samples)
        for run in self._runs(samples) if len(samples) else []:
            for passed in self._imu_clock.admit(int(run.stamps_ns[0]), int(run.stamps_ns[-1]), run, arrival_ns):
                out.extend(self._emit(passed))
        return out

    def _usable(self, samples: ImuSamples) -> ImuSamples:
        usable = np.array([_is_usable(_slice(samples, k, k + 1)) for k in range(len(samples))])
        for gyro, accel in zip(samples.gyro_radps[~usable], samples.accel_mps2[~usable], strict=True):
            self.dropped["imu_range" if np.isfinite([gyro, accel]).all() else "imu_nan"] += 1
        return _take(samples, usable)

    def _runs(self, samples: ImuSamples) -> list[ImuSamples]:
        """The chunk as it is when time simply goes on in it, else its samples one by one."""
        if len(samples) == 1 or self._goes_on(samples):
            return [samples]
        return [_slice(samples, k, k + 1) for k in range(len(samples))]

    def _goes_on(self, samples: ImuSamples) -> bool:
        return self._imu_clock.follows(int(samples.stamps_ns[0])) and goes_on(samples.stamps_ns, JUMP_NS)

    def _emit(self, samples: ImuSamples) -> list[Item]:
        """The samples, with each waiting scan put right after the first sample at or after its end."""
        self._silent = False
        out: list[Item] = []
        done = 0
        while self._waiting:
            cover = int(np.searchsorted(samples.stamps_ns, self._waiting[0][0].end_ns))
            if cover == len(samples):
                break
            if cover >= done:
                out.append(_slice(samples, done, cover + 1))
                done = cover + 1
            self._covered_ns = int(samples.stamps_ns[done - 1])
            out.append(self._release())
        if done < len(samples):
            out.append(_slice(samples, done, len(samples)))
        self._covered_ns = int(samples.stamps_ns[-1])
        return out

    def _covers(self, scan: Scan) -> bool:
        return not self._imu or (self._covered_ns is not None and self._covered_ns >= scan.end_ns)

    def _release(self) -> ScanPacket:
        scan, arrival_ns = self._waiting.popleft()
        if not self._covers(scan):
            self.uncovered += 1
            self._imu_clock.pass_by(scan.end_ns)
        packet = ScanPacket(scan, tuple(self._fixes), arrival_ns)
        self._fixes.clear()
        return packet


def _is_usable(samples: ImuSamples) -> bool:
    """Finite, and within what a sensor measures."""
    return all_within(samples.gyro_radps, _MOST_RADPS) and all_within(samples.accel_mps2, _MOST_MPS2)


def _take(samples: ImuSamples, keep: NDArray[np.bool_]) -> ImuSamples:
    if keep.all():
        return samples
    return ImuSamples(samples.stamps_ns[keep], samples.gyro_radps[keep], samples.accel_mps2[keep])


def _slice(samples: ImuSamples, start: int, stop: int) -> ImuSamples:
    if start == 0 and stop == len(samples):
        return samples
    part = slice(start, stop)
    return ImuSamples(samples.stamps_ns[part], samples.gyro_radps[part], samples.accel_mps2[part])
