"""`splitslam check`: one pass over the beginning of a recording, then everything that can be said about it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from edge_agent.sources import Recording, beams, open_recording
from splitslam.check import layout, point_times, streams
from splitslam.check.findings import Finding, note
from splitslam.check.imu_verdict import ImuVerdict, judge
from splitslam.check.layout import Layout, LayoutProbe
from splitslam.check.motion import LidarMotion
from splitslam.check.odometry import LidarOdometry
from splitslam.check.point_times import PointTimeProbe, TimeShare
from splitslam.check.repair import repaired
from splitslam.check.streams import StreamStatistics
from splitslam.check.table_one import TableOne, table_one
from splitslam.errors import InputError
from splitslam.robot import Robot, load_robot
from splitslam.scan import GnssFix, ImuSamples, Scan, WheelSamples

DEFAULT_S = 60.0
_LOOK_EVERY = 5  # scans whose layout is looked at
_LOST_SHARE = 0.05
_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, slots=True, eq=False)
class Report:
    """Everything a check found. streams: by section of the robot file. point_times, imu, table: None where unknown.

    recorded_s: length of the part that was looked at.
    """

    recording: Path
    robot: Robot
    recorded_s: float
    findings: tuple[Finding, ...]
    streams: dict[str, StreamStatistics]
    layout: Layout
    point_times: TimeShare | None
    imu: ImuVerdict | None
    table: TableOne | None


@dataclass(slots=True)
class _Heard:
    """What one pass collects, in order of arrival."""

    scan_ns: list[int] = field(default_factory=list)
    fix_ns: list[int] = field(default_factory=list)
    wheels_ns: list[int] = field(default_factory=list)
    imu_ns: list[NDArray[np.int64]] = field(default_factory=list)
    imu_values: list[NDArray[np.float64]] = field(default_factory=list)
    recorded_s: float = 0.0

    def imu_stamps_ns(self) -> NDArray[np.int64]:
        return np.concatenate([np.empty(0, np.int64), *self.imu_ns])

    def imu(self) -> ImuSamples | None:
        """Rising in time, each stamp once."""
        stamps_ns, first = np.unique(self.imu_stamps_ns(), return_index=True)
        if len(stamps_ns) < 20:
            return None
        values = np.concatenate(self.imu_values)[first]
        return ImuSamples(stamps_ns, values[:, :3], values[:, 3:])


def check_recording(
    path: Path, robot_path: Path, seconds: float = DEFAULT_S, progress: Callable[[int, int], None] | None = None
) -> Report:
    """Looks at the first `seconds` of a recording. progress(done, expected) is called after each scan.

    Raises InputError when recording or robot file cannot be used at all; what can be mended is a finding.
    """
    robot, found = repaired(path, load_robot(robot_path, placed_elsewhere=True))
    with open_recording(path, robot) as recording:
        heard, probes = _Heard(), (LayoutProbe(robot.lidar), PointTimeProbe())
        odometry = LidarOdometry(robot, recording.beam_elevations_rad)
        _listen(recording, seconds, heard, probes, odometry, progress)
    motion, more = _motion(odometry, len(heard.scan_ns))
    found += more
    share = None if motion is None else probes[1].share(motion)
    found += point_times.findings(share)
    found += _drops(recording)
    stats = _streams(robot, heard)
    found += [line for name, s in stats.items() for line in streams.findings(name, s, _stated_hz(robot, name))]
    counts = recording.counts
    seen = probes[0].layout(counts.left_out["nan"] / max(counts.read_points + sum(counts.left_out.values()), 1))
    known = beams.known_elevations_rad(robot.lidar)
    period_s = stats["lidar"].period_s
    found += layout.findings(seen, robot.lidar, period_s, known, counts.left_out, counts.read_points)
    found += [note("lidar", text) for text in recording.notes if text.startswith("point")]
    samples = heard.imu()
    verdict = None
    if robot.imu is not None and samples is None:
        found.append(Finding(robot.imu.topic or "imu", "fewer than 20 samples that can be used", "an IMU"))
    elif samples is not None and heard.scan_ns:
        clock = streams.same_clock(np.array(heard.scan_ns), samples.stamps_ns)
        found += [] if clock is None else [clock]
        verdict = judge(robot, motion, samples, period_s)
        found += verdict.findings
        found += _slips(verdict)
    return Report(
        recording=path,
        robot=robot,
        recorded_s=heard.recorded_s,
        findings=tuple(found),
        streams=stats,
        layout=seen,
        point_times=share,
        imu=verdict,
        table=None if motion is None else _table(motion, verdict, len(heard.scan_ns)),
    )


def _listen(
    recording: Recording,
    seconds: float,
    heard: _Heard,
    probes: tuple[LayoutProbe, PointTimeProbe],
    odometry: LidarOdometry,
    progress: Callable[[int, int], None] | None,
) -> None:
    first_ns: int | None = None
    for arrival_ns, event in recording.events():
        first_ns = arrival_ns if first_ns is None else first_ns
        if arrival_ns - first_ns > seconds * 1e9:
            break
        heard.recorded_s = (arrival_ns - first_ns) * 1e-9
        if isinstance(event, ImuSamples):
            heard.imu_ns.append(event.stamps_ns)
            heard.imu_values.append(np.hstack([event.gyro_radps, event.accel_mps2]))
        elif isinstance(event, Scan):
            if len(heard.scan_ns) % _LOOK_EVERY == 0:
                probes[0].add(event)
            probes[1].add(event)
            heard.scan_ns.append(event.stamp_ns)
            odometry.add(event)
            if progress is not None:
                progress(len(heard.scan_ns), recording.scan_count)
        elif isinstance(event, GnssFix):
            heard.fix_ns.append(event.stamp_ns)
        elif isinstance(event, WheelSamples):
            heard.wheels_ns += event.stamps_ns.tolist()
    if not heard.scan_ns:
        why = ", ".join(f"{n} {reason}" for reason, n in sorted(recording.dropped.items())) or "none in it"
        left = ", ".join(f"{n} points {reason}" for reason, n in sorted(recording.counts.left_out.items()))
        raise InputError(f"{recording.topics['lidar']}: no usable scans ({why}; {left}); expected at least one")


def _motion(odometry: LidarOdometry, scans: int) -> tuple[LidarMotion | None, list[Finding]]:
    if odometry.lost > _LOST_SHARE * scans:
        text = f"LiDAR odometry without the IMU was lost in {odometry.lost} of {scans} scans"
        return None, [note("T_lidar_imu", f"not tested: {text}", "a place with structure, slower motion")]
    return odometry.motion(), []


def _slips(verdict: ImuVerdict) -> list[Finding]:
    if verdict.alignment is None or not verdict.alignment.slips:
        return []
    text = f"LiDAR odometry without the IMU slipped in {verdict.alignment.slips} scans: the row of Table I is not exact"
    return [note("lidar", text, "slower turns")]


def _streams(robot: Robot, heard: _Heard) -> dict[str, StreamStatistics]:
    stamps = {"lidar": np.array(heard.scan_ns, np.int64)}
    if robot.imu is not None:
        stamps["imu"] = heard.imu_stamps_ns()
    if robot.wheels is not None:
        stamps["wheels"] = np.array(heard.wheels_ns, np.int64)
    if robot.gnss is not None:
        stamps["gnss"] = np.array(heard.fix_ns, np.int64)
    return {name: streams.statistics(stamps_ns) for name, stamps_ns in stamps.items()}


def _stated_hz(robot: Robot, name: str) -> float | None:
    """GNSS has no rate in the robot file."""
    section = getattr(robot, name)
    return getattr(section, "rate_hz", None)


def _drops(recording: Recording) -> list[Finding]:
    """Messages that could not be used, by reason."""
    dropped = Counter(recording.dropped)
    out = []
    no_fix = dropped.pop("gnss_no_fix", 0)
    if no_fix:
        out.append(note(recording.topics.get("gnss", "gnss"), f"{no_fix} messages without a fix"))
    for reason, count in sorted(dropped.items()):
        topic = recording.topics.get(reason.partition("_")[0], recording.topics["lidar"])
        out.append(Finding(topic, f"{count} messages cannot be used ({reason})", "none"))
    return out


def _table(motion: LidarMotion, verdict: ImuVerdict | None, scans: int) -> TableOne:
    up = _UP
    if verdict is not None and verdict.alignment is not None:
        up = -verdict.alignment.gravity_odom_mps2 / np.linalg.norm(verdict.alignment.gravity_odom_mps2)
    return table_one(scans, motion, up, None if verdict is None else verdict.samples)
