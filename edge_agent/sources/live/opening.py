"""From the configuration and the robot file to open ports and a LiveSource."""

from __future__ import annotations

from collections import Counter
from contextlib import ExitStack
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from edge_agent.live_settings import LiveConfig
from edge_agent.sources import beams
from edge_agent.sources.live import raw_messages
from edge_agent.sources.live.arrivals import ArrivalClock
from edge_agent.sources.live.clock import RunClock
from edge_agent.sources.live.feed import Feed
from edge_agent.sources.live.ports import Port
from edge_agent.sources.live.presence import Presence
from edge_agent.sources.live.source import Input, LiveSource
from edge_agent.sources.live.stream_ports import SerialPort, TcpPort
from edge_agent.sources.live.udp_port import UdpPort
from edge_agent.sources.source import Counts
from splitslam.errors import InputError
from splitslam.robot import Robot

VELODYNES = ("vlp16", "hdl32")
OUSTER = "ouster"
VELODYNE_PORT, OUSTER_PORT = 2368, 7502
_LIDAR, _IMU, _GNSS = "lidar", "imu", "gnss"


def open_live(config: LiveConfig, robot: Robot) -> LiveSource:
    """Opens every port. Raises InputError for one that cannot be had, or a robot file that does not fit."""
    with ExitStack() as opened:
        source = _Opening(config, robot, opened).source()
        opened.pop_all()
        return source


@dataclass
class _Opening:
    """What is put together, sensor by sensor."""

    config: LiveConfig
    robot: Robot
    opened: ExitStack  # closes the ports again if a later one cannot be had
    inputs: list[Input] = field(default_factory=list)
    topics: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    counts: Counts = field(default_factory=Counts)
    dropped: Counter[str] = field(default_factory=Counter)
    arrivals: ArrivalClock = field(default_factory=ArrivalClock)

    def __post_init__(self) -> None:
        names = [_LIDAR, _IMU] if self.config.imu is not None else [_LIDAR]
        self.clocks = RunClock(self.config.clock, self.config.apart_s, names)

    def source(self) -> LiveSource:
        """Everything open."""
        model = self.robot.lidar.model
        if model in VELODYNES:
            elevations = self._velodyne()
        elif model == OUSTER:
            elevations = self._ouster()
        else:
            expected = ", ".join((*VELODYNES, OUSTER))
            raise InputError(
                f"source.live: lidar.model: {model} is not read live; expected one of {expected}, or source.ros2 with"
                " the sensor's own driver"
            )
        self._imu()
        self._gnss()
        robot = self._robot()
        presence = Presence(list(self.topics), self.config.silent_s)
        return LiveSource(
            robot,
            self.topics,
            self.notes,
            elevations,
            self.inputs,
            self.arrivals,
            self.clocks,
            presence,
            self.counts,
            self.dropped,
        )

    # --- sensors ----------------------------------------------------------------------------------------------

    def _velodyne(self) -> NDArray[np.float32]:
        from edge_agent.sources.live.velodyne import PositionFeed, VelodyneFeed

        lidar, udp = self.robot.lidar, self.config.lidar.udp
        elevations = beams.known_elevations_rad(lidar)
        if elevations is None:
            raise InputError(f"lidar.beam_elevations_deg: must be given for a live {lidar.model}")
        position = PositionFeed()
        if udp.position_port is not None:
            self._listen(_LIDAR, "position_port", udp.position_port, position)
        feed = VelodyneFeed(self.robot, self.clocks.clock(_LIDAR), position, self.counts, self.dropped)
        self._listen(_LIDAR, "port", VELODYNE_PORT if udp.port is None else udp.port, feed)
        self.topics[_LIDAR] = raw_messages.TURN_TOPIC
        return elevations

    def _ouster(self) -> NDArray[np.float32]:
        from edge_agent.sources.live.ouster import open_ouster

        udp = self.config.lidar.udp
        sensor = open_ouster(self.robot, self.clocks.clock(_LIDAR), self.counts, self.dropped)
        self._listen(_LIDAR, "port", OUSTER_PORT if udp.port is None else udp.port, sensor.lidar)
        self.topics[_LIDAR] = raw_messages.CLOUD_TOPIC
        if self.config.imu is None and self.robot.imu is not None:
            self._listen(_IMU, "imu_port", udp.imu_port, sensor.imu)
            self.topics[_IMU] = raw_messages.IMU_TOPIC
            if not self.robot.imu_placed:
                self.robot = self.robot.model_copy(update={"T_lidar_imu": sensor.T_lidar_imu})
                self.notes.append("imu: T_lidar_imu from the LiDAR's metadata")
        elevations = beams.known_elevations_rad(self.robot.lidar)
        assert elevations is not None  # the metadata has them
        return elevations

    def _imu(self) -> None:
        if self.config.imu is None:
            return
        if self.robot.imu is None:
            raise InputError("source.live.imu: the robot file says that there is none; expected a section imu in it")
        from edge_agent.sources.live.mip import MipFeed

        offset_ns = self.robot.imu.time_offset_ns
        feed = MipFeed(self.clocks.clock(_IMU), offset_ns, self.counts, self.dropped)
        serial = self.config.imu.serial
        self._add(_IMU, SerialPort(_IMU, serial, self.arrivals), feed, f"mip on {serial.device}")
        self.topics[_IMU] = raw_messages.IMU_TOPIC

    def _gnss(self) -> None:
        gnss = self.config.gnss
        if gnss is None:
            return
        if self.robot.gnss is None:
            raise InputError("source.live.gnss: the robot file says that there is none; expected a section gnss in it")
        from edge_agent.sources.live.nmea import NmeaFeed

        feed = NmeaFeed(self.clocks.clock(_GNSS), self.dropped)
        if gnss.serial is not None:
            port: Port = SerialPort(_GNSS, gnss.serial, self.arrivals)
            where = str(gnss.serial.device)
        else:
            assert gnss.tcp is not None  # the configuration has exactly one
            port, where = TcpPort(_GNSS, gnss.tcp, self.arrivals), f"tcp {gnss.tcp.host}:{gnss.tcp.port}"
        self._add(_GNSS, port, feed, f"nmea on {where}")
        self.topics[_GNSS] = raw_messages.FIX_TOPIC

    # --- parts ------------------------------------------------------------------------------------------------

    def _listen(self, sensor: str, key: str, port: int, feed: Feed) -> None:
        udp = self.config.lidar.udp
        where = f"source.live.lidar.udp.{key}"
        opened = UdpPort(where, (udp.host, port), self.config.receive_bytes, udp.sender, self.arrivals)
        self._add(sensor, opened, feed, f"{self.robot.lidar.model} on udp {udp.host}:{opened.port} ({key})")
        if key == "port" and opened.receive_bytes < self.config.receive_bytes:
            granted = f"{opened.receive_bytes} of {self.config.receive_bytes} bytes"
            self.notes.append(f"{sensor}: the system grants a buffer of {granted} (net.core.rmem_max)")

    def _add(self, sensor: str, port: Port, feed: Feed, said: str) -> None:
        self.opened.callback(port.close)
        self.inputs.append(Input(sensor, port, feed))
        self.notes.append(f"{sensor}: {said}")

    def _robot(self) -> Robot:
        """The robot file with the sensors that are read; topics are the raw ring's."""
        sections = {}
        for name in (_LIDAR, _IMU, _GNSS):
            section = getattr(self.robot, name)
            if section is None:
                continue
            if name not in self.topics:
                self.notes.append(f"{name}: in the robot file, but not in source.live: not used")
                sections[name] = None
            else:
                sections[name] = section.model_copy(update={"topic": self.topics[name]})
        if _IMU in self.topics and not self.robot.imu_placed:
            raise InputError(
                "robot file: T_lidar_imu: must be given when there is an IMU (p_lidar = T_lidar_imu @ p_imu)"
            )
        if self.robot.wheels is not None:
            self.notes.append("wheels: in the robot file, but not read live: not used")
            sections["wheels"] = None
        return self.robot.model_copy(update=sections)
