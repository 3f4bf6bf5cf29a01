"""The robot file held against the first seconds of a run: stamps, units and gravity by the sensors alone, mounting and
delay of the IMU by the poses that come back.

Those poses start from a prediction that the IMU makes, with whatever is wrong about it; registration takes that out
again, so that what is left of it in the rotation from scan to scan is small. What a recording says by itself:
`splitslam check`.
"""

from __future__ import annotations

import logging
import math
import threading
from dataclasses import dataclass, field, replace

import numpy as np

from edge_agent.metrics import EdgeMetrics
from edge_agent.odometry.outage import LOST
from edge_agent.sources import Event
from edge_agent.wire import Answer
from splitslam import se3
from splitslam.check import streams
from splitslam.check.coarse import thinned
from splitslam.check.findings import Finding, Severity, note, problems
from splitslam.check.imu_verdict import ImuVerdict, judge
from splitslam.check.motion import LidarMotion
from splitslam.logs import fields
from splitslam.robot import Robot
from splitslam.scan import GnssFix, ImuSamples, Scan

_log = logging.getLogger(__name__)

_LOOK_AT_S = (10.0, 20.0, 40.0, 80.0)  # of answered motion; later ones only while something is not known yet
_MOST_SAMPLES, _MOST_SCANS = 240_000, 5000  # three times what the last look needs, at 1 kHz
_NAME = "check"
_CHECKED = "a robot file in which `splitslam check` finds no problem, a place with structure"


@dataclass(slots=True)
class _Heard:
    """What has come so far, in order of arrival."""

    scans_ns: list[int] = field(default_factory=list)
    fixes_ns: list[int] = field(default_factory=list)
    samples: list[ImuSamples] = field(default_factory=list)
    sample_count: int = 0  # in all of them: looked at with each scan, and there are hundreds
    poses_ns: list[int] = field(default_factory=list)
    poses: list[np.ndarray] = field(default_factory=list)
    lost: int = 0

    @property
    def is_much(self) -> bool:
        """More than any look needs."""
        return self.sample_count > _MOST_SAMPLES or max(len(self.scans_ns), len(self.fixes_ns)) > _MOST_SCANS

    def copy(self) -> _Heard:
        return replace(
            self,
            scans_ns=[*self.scans_ns],
            fixes_ns=[*self.fixes_ns],
            samples=[*self.samples],
            poses_ns=[*self.poses_ns],
            poses=[*self.poses],
        )


class LiveCheck:
    """Fed by the loop, looks at 10, 20, 40 and 80 s until everything is known; the looking is done in a thread.

    findings: of the newest look.
    """

    def __init__(self, robot: Robot, metrics: EdgeMetrics) -> None:
        self.findings: list[Finding] = []
        self._robot, self._metrics = robot, metrics
        self._heard = _Heard()
        self._looks = iter(_LOOK_AT_S)
        self._next_s: float | None = next(self._looks)
        self._looking: threading.Thread | None = None
        self._done = False  # nothing more to find out
        self._told: set[str] = set()

    def on_event(self, event: Event) -> None:
        """A sensor message as it came, before the sequencer has put anything right."""
        if self._done or self._next_s is None:
            self._heard = _Heard()
            return
        if isinstance(event, ImuSamples):
            self._heard.samples.append(event)
            self._heard.sample_count += len(event)
            if len(self._heard.samples) > 1000:
                self._heard.samples = [ImuSamples.joined(self._heard.samples)]
                self._begin_anew()
        elif isinstance(event, Scan):
            self._heard.scans_ns.append(event.stamp_ns)
            self._begin_anew()
        elif isinstance(event, GnssFix):
            self._heard.fixes_ns.append(event.stamp_ns)

    def _begin_anew(self) -> None:
        """Without answers the looks do not end: what was heard until then must not fill the memory meanwhile."""
        if self._heard.is_much:
            self._heard = _Heard()

    def on_answer(self, answer: Answer) -> None:
        """An answer of the map service, in order."""
        if self._done or self._next_s is None or answer.reply.rejected:
            return
        heard, reply = self._heard, answer.reply
        if heard.poses_ns and reply.stamp_ns <= heard.poses_ns[-1]:
            return
        heard.poses_ns.append(reply.stamp_ns)
        heard.poses.append(se3.inv(reply.T_map_odom) @ reply.T_map_lidar)  # corrections of the map are no motion
        heard.lost += reply.state == LOST
        if (reply.stamp_ns - heard.poses_ns[0]) * 1e-9 >= self._next_s and not self._busy():
            self._next_s = next(self._looks, None)
            self._looking = threading.Thread(target=self._look, args=(heard.copy(),), name=_NAME, daemon=True)
            self._looking.start()

    def finish(self) -> list[Finding]:
        """End of the run: the findings; a run too short for the first look is looked at now."""
        if self._looking is not None:
            self._looking.join()
        elif self._heard.scans_ns:
            self._look(self._heard)
        return self.findings

    def _busy(self) -> bool:
        return self._looking is not None and self._looking.is_alive()

    def _look(self, heard: _Heard) -> None:
        try:
            self._take(*self._judged(heard))
        except Exception:  # a check must never end a run
            _log.exception("check failed")

    def _judged(self, heard: _Heard) -> tuple[list[Finding], ImuVerdict | None]:
        lidar = streams.statistics(np.array(heard.scans_ns, np.int64))
        found = streams.findings("lidar", lidar, self._robot.lidar.rate_hz)
        if heard.fixes_ns:
            found += streams.findings("gnss", streams.statistics(np.array(heard.fixes_ns, np.int64)), None)
        imu = self._robot.imu
        if imu is None:
            return found, None
        if heard.sample_count < 20:
            return [*found, Finding("imu", "fewer than 20 samples so far", f"{imu.rate_hz:g} a second")], None
        came = ImuSamples.joined(heard.samples)
        found += streams.findings("imu", streams.statistics(came.stamps_ns), imu.rate_hz)
        samples = _rising(came)
        clock = streams.same_clock(np.array(heard.scans_ns), samples.stamps_ns)
        if clock is not None and clock.severity is Severity.PROBLEM:
            return [*found, clock], None
        motion = None
        if heard.lost > 0.05 * len(heard.poses):
            found.append(note("T_lidar_imu", f"not tested: the map service was lost in {heard.lost} scans"))
            self._tell_lost(heard)
        elif len(heard.poses) >= 3:
            motion = LidarMotion(np.array(heard.poses_ns), np.array(heard.poses))
        verdict = judge(self._robot, motion, thinned(samples), lidar.period_s)
        return [*found, *map(_without_figures, verdict.findings)], verdict

    def _tell_lost(self, heard: _Heard) -> None:
        """A mounting that is half a turn off loses the robot before it can be measured: no finding, but no silence."""
        if "lost" not in self._told:
            self._told.add("lost")
            detail = f"the map service was lost in {heard.lost} of {len(heard.poses)} scans"
            _log.warning("robot lost", extra=fields(detail=detail, expected=_CHECKED))

    def _take(self, findings: list[Finding], verdict: ImuVerdict | None) -> None:
        self.findings = findings
        wrong = problems(findings)
        self._metrics.check_problems.set(len(wrong))
        place = None if verdict is None else verdict.mounting
        if place is not None:
            self._metrics.check_rotation.set(math.radians(place.angle_deg))
            self._metrics.check_time_offset.set(place.time_offset_s - place.stated_offset_s)
            self._done = place.unknown_axis is None and 3.0 * place.time_sigma_s < place.delay_limit_s
        for finding in wrong:
            if finding.where not in self._told:
                self._told.add(finding.where)
                said = fields(where=finding.where, detail=finding.what, expected=finding.expected)
                _log.warning("robot file and data disagree", extra=said)


def _without_figures(finding: Finding) -> Finding:
    """A live run shows that the mounting is wrong; its poses lean a little on the IMU, so not exactly by how much."""
    if finding.where == "T_lidar_imu" and finding.severity is Severity.PROBLEM:
        return replace(finding, expected="what `splitslam check` finds in a recording of this robot")
    return finding


def _rising(samples: ImuSamples) -> ImuSamples:
    """In order of time, each stamp once."""
    stamps_ns, first = np.unique(samples.stamps_ns, return_index=True)
    return ImuSamples(stamps_ns, samples.gyro_radps[first], samples.accel_mps2[first])
