"""An Ouster's LiDAR and IMU packets -> scans and samples; packets are parsed by ouster-sdk.

Frame `lidar` is Ouster's sensor frame (x away from the connector, z up), as in the SDK's own XYZ.
"""

from __future__ import annotations

import json
import logging
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from edge_agent.sources.live.feed import Reading
from edge_agent.sources.live.frames import Columns, Frame, Frames
from edge_agent.sources.live.sensor_clock import SensorClock, TimeBase
from edge_agent.sources.raw import Gate, RawScan
from edge_agent.sources.source import Counts
from splitslam.config import read_text
from splitslam.errors import DataError, InputError
from splitslam.logs import fields
from splitslam.robot import Robot
from splitslam.scan import ImuSamples

_log = logging.getLogger(__name__)

_TIMESTAMP, _MEASUREMENT, _STATUS = 0, 2, 3  # headers of a column
_VALID = 1
_STANDARD_GRAVITY_MPS2 = 9.80665
_LONGEST_NS = 1 << 62  # no clock gets so far, and 64 bits must do for sums
_EPOCH_LIKE_NS = 10**18  # since 2001: a time that somebody has set; since it was switched on is less
_BASES = {"TIME_FROM_PTP_1588": TimeBase.PTP, "TIME_FROM_SYNC_PULSE_IN": TimeBase.GPS}


@dataclass(frozen=True, slots=True)
class Ouster:
    """The two feeds of one sensor, and where its IMU sits: (4, 4) float64."""

    lidar: OusterLidarFeed
    imu: OusterImuFeed
    T_lidar_imu: NDArray[np.float64]


def open_ouster(robot: Robot, clock: SensorClock, counts: Counts, dropped: Counter[str]) -> Ouster:
    """Raises InputError: no metadata, not to be read by the SDK, not the robot file's shape; SDK not installed."""
    sdk = _sdk()
    path = robot.lidar.metadata
    if path is None:
        raise InputError(
            "lidar.metadata: must be given for a live ouster: the JSON of http://SENSOR/api/v1/sensor/metadata"
        )
    text = read_text(Path(path))
    try:
        info = sdk.SensorInfo(text)
    except Exception as error:  # the SDK raises whatever its parser trips over
        raise InputError(f"{path}: not Ouster metadata: {' '.join(str(error).split())}") from None
    parser = Parser(sdk, info, _base_of(text))
    if parser.rings != robot.lidar.rings:
        raise InputError(f"lidar.rings: {robot.lidar.rings}, but {path} says {parser.rings}")
    T_lidar_imu = np.array(info.imu_to_sensor_transform, dtype=np.float64)
    T_lidar_imu[:3, 3] *= 1e-3  # mm in the metadata
    offset_ns = 0 if robot.imu is None else robot.imu.time_offset_ns
    return Ouster(
        OusterLidarFeed(parser, robot, clock, counts, dropped),
        OusterImuFeed(parser, clock, offset_ns, counts, dropped),
        T_lidar_imu,
    )


def _sdk() -> ModuleType:
    try:
        from ouster.sdk import core
    except ImportError:
        raise InputError(
            "lidar.model: ouster: the packets of a live Ouster are parsed by ouster-sdk, which is not installed;"
            " expected: pip install --no-deps ouster-sdk==1.0.1"
        ) from None
    return core


def _base_of(metadata: str) -> TimeBase:
    """Whose time the sensor is told to stamp with; OWN where the metadata does not say."""
    data = json.loads(metadata)
    mode = data.get("config_params", data).get("timestamp_mode", "")
    return _BASES.get(mode, TimeBase.OWN)


class Parser:
    """ouster-sdk's view of one sensor's packets."""

    def __init__(self, sdk: ModuleType, info: Any, base: TimeBase) -> None:
        self._format = sdk.PacketFormat(info)
        self.lut = sdk.XYZLut(info, False)
        self._base = base
        shape = info.format
        self.rings, self.columns = int(shape.pixels_per_column), int(shape.columns_per_frame)
        self.columns_per_packet = int(shape.columns_per_packet)
        self.window = tuple(int(edge) for edge in shape.column_window)
        self.lidar_bytes, self.imu_bytes = int(self._format.lidar_packet_size), int(self._format.imu_packet_size)
        self.imu_is_legacy = int(self._format.imu_measurements_per_packet) in (0, 1)

    def columns_of(self, data: bytes) -> Columns:
        """A LiDAR packet's columns."""
        buffer = np.frombuffer(data, dtype=np.uint8)
        header = self._format.packet_header
        return Columns(
            frame=int(self._format.frame_id(buffer)),
            place=header(_MEASUREMENT, buffer).astype(np.int64),
            stamps_ns=header(_TIMESTAMP, buffer).astype(np.int64),
            valid=(header(_STATUS, buffer) & _VALID).astype(bool),
            range_mm=self._format.packet_field("RANGE", buffer),
            reflectivity=self._format.packet_field("REFLECTIVITY", buffer),
        )

    def imu_of(self, data: bytes) -> tuple[int, list[float], list[float]]:
        """Stamp ns, gyro rad/s, accel m/s^2 of an IMU packet."""
        buffer, f = np.frombuffer(data, dtype=np.uint8), self._format
        gyro_degps = (f.imu_av_x(buffer), f.imu_av_y(buffer), f.imu_av_z(buffer))
        accel_g = (f.imu_la_x(buffer), f.imu_la_y(buffer), f.imu_la_z(buffer))
        gyro = [float(np.deg2rad(value)) for value in gyro_degps]
        return int(f.imu_gyro_ts(buffer)), gyro, [value * _STANDARD_GRAVITY_MPS2 for value in accel_g]

    def base(self, stamp_ns: int) -> TimeBase:
        """Whose time a stamp is in: a sensor that waits for its grandmaster counts from when it was switched on."""
        return self._base if stamp_ns > _EPOCH_LIKE_NS else TimeBase.OWN


class OusterLidarFeed:
    """LiDAR packets, put together to frames and those to scans; points in the order in which they were fired."""

    def __init__(self, parser: Parser, robot: Robot, clock: SensorClock, counts: Counts, dropped: Counter[str]) -> None:
        self.counts: Counter[str] = Counter()
        self.parser, self._clock, self._read, self._dropped = parser, clock, counts, dropped
        first, last = parser.window
        columns = (last - first) % parser.columns + 1
        packets = -(-columns // parser.columns_per_packet)
        self._frames = Frames(parser.rings, parser.columns, packets, first, self.counts)
        self._gate = Gate(robot, counts.left_out)

    def take(self, data: bytes, arrival_ns: int) -> Iterator[Reading]:
        """One packet."""
        if len(data) != self.parser.lidar_bytes:
            self.counts["size"] += 1
            return
        columns = self.parser.columns_of(data)
        newest_ns = int(columns.stamps_ns[columns.valid].max(initial=0))
        if newest_ns:
            base = self.parser.base(newest_ns)
            if base is not self._clock.base:  # a frame is of one time
                for frame in self._frames.flush():
                    yield from self._decoded(frame)
            self._clock.heard(newest_ns, arrival_ns, base)
        for frame in self._frames.add(columns):
            yield from self._decoded(frame)

    def quiet(self) -> Iterator[Reading]:
        """The frame that has begun goes as far as it has come."""
        for frame in self._frames.flush():
            yield from self._decoded(frame)

    def _decoded(self, frame: Frame) -> Iterator[Reading]:
        self._read.scans_read += 1
        native_bytes = self.parser.lidar_bytes * len(frame.seen)
        self._read.native_bytes += native_bytes
        try:
            scan = self._gate(self._raw(frame, native_bytes))
        except DataError as error:
            self._dropped[error.reason] += 1
            _log.warning("scan not decoded", extra=fields(reason=error.reason, detail=error.detail))
            return
        self._read.read_points += len(scan)
        yield Reading("lidar", self._clock, scan)

    def _raw(self, frame: Frame, native_bytes: int) -> RawScan:
        """Returns only, by column: that is the order of time, but for where a window begins."""
        fired_ns = frame.stamps_ns[frame.valid]
        if len(fired_ns) == 0:
            raise DataError("empty", "no valid column")
        stamp_ns, end_ns = int(fired_ns.min()), int(fired_ns.max())
        order = np.argsort(frame.stamps_ns, kind="stable")
        turn, ring = np.nonzero(frame.range_mm[:, order].T)
        column = order[turn]
        points = np.asarray(self.parser.lut(frame.range_mm), dtype=np.float32)
        return RawScan(
            stamp_ns=stamp_ns,
            end_ns=end_ns,
            points_lidar=points[ring, column],
            t_offset_ns=frame.stamps_ns[column] - stamp_ns,
            ring=ring,
            intensity=np.minimum(frame.reflectivity[ring, column], 255).astype(np.uint8),
            native_bytes=native_bytes,
        )


class OusterImuFeed:
    """IMU packets of one sample each (100 Hz)."""

    def __init__(
        self, parser: Parser, clock: SensorClock, time_offset_ns: int, counts: Counts, dropped: Counter[str]
    ) -> None:
        self.counts: Counter[str] = Counter()
        self._parser, self._clock, self._time_offset_ns = parser, clock, time_offset_ns
        self._read, self._dropped = counts, dropped

    def take(self, data: bytes, arrival_ns: int) -> Iterator[Reading]:
        """One packet."""
        if len(data) != self._parser.imu_bytes:
            self.counts["size"] += 1
            return
        stamp_ns, gyro_radps, accel_mps2 = self._parser.imu_of(data)
        self.counts["used"] += 1
        self._read.imu_messages += 1
        if self._clock.chosen and self._parser.base(stamp_ns) is not self._clock.base:
            self._dropped["clock_changed"] += 1  # the LiDAR's packets tell by how much
            return
        if not np.isfinite([*gyro_radps, *accel_mps2]).all():
            self._dropped["imu_nan"] += 1
            return
        if stamp_ns >= _LONGEST_NS:
            self._dropped["imu_time_jump"] += 1
            return
        stamps_ns = np.array([stamp_ns + self._time_offset_ns], dtype=np.int64)
        yield Reading("imu", self._clock, ImuSamples(stamps_ns, np.array([gyro_radps]), np.array([accel_mps2])))

    def quiet(self) -> Iterator[Reading]:
        """Nothing is held back."""
        return iter(())
