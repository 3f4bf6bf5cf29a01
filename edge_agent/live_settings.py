"""The section `source.live`: which sensor comes in where."""

from __future__ import annotations

import ipaddress
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from splitslam.config import Model


def _address(text: str) -> str:
    try:
        return str(ipaddress.ip_address(text))
    except ValueError:
        raise ValueError("expected an IP address, such as 192.168.1.201") from None


Address = Annotated[str, AfterValidator(_address)]  # no name: while the robot drives nobody waits for a name server
Port = Annotated[int, Field(ge=0, le=65535)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
ClockChoice = Literal["auto", "gps", "ptp", "host"]


class Udp(Model):
    """Where the LiDAR's packets come in; port 0 is any free one, which is printed.

    host: our address to listen on. port: null: what the maker ships (Velodyne 2368, Ouster 7502).
    position_port: Velodyne's position packets with $GPRMC, null: none are wanted. imu_port: Ouster's IMU packets.
    sender: packets from another address are counted and left out, null: from anywhere.
    """

    host: Address = "0.0.0.0"
    port: Port | None = None
    position_port: Port | None = 8308
    imu_port: Port = 7503
    sender: Address | None = None


class LidarInput(Model):
    """The LiDAR; its model and metadata are in the robot file."""

    udp: Udp = Udp()


class Serial(Model):
    """A serial device, best by its stable name (/dev/serial/by-id/...)."""

    device: Path
    baud: Annotated[int, Field(gt=0)] = 115200


class Tcp(Model):
    """A server that sends us its bytes, such as a receiver in the robot's network."""

    host: Address
    port: Annotated[int, Field(ge=1, le=65535)]


class ImuInput(Model):
    """protocol: mip (MicroStrain)."""

    serial: Serial
    protocol: Literal["mip"] = "mip"


class GnssInput(Model):
    """A receiver that speaks NMEA, at a serial device or over TCP."""

    serial: Serial | None = None
    tcp: Tcp | None = None

    @model_validator(mode="after")
    def _exactly_one(self) -> Self:
        if (self.serial is None) == (self.tcp is None):
            raise ValueError("expected exactly one of serial, tcp")
        return self


class LiveConfig(Model):
    """Sensors that are read without ROS.

    imu: null: an Ouster's own, with another LiDAR none. gnss: null: none.
    clock: auto: a sensor's own time where its packets say that it is locked to GPS or PTP, else when they come in;
    gps, ptp: that one, and a sensor that is not locked to it is said to be wrong; host: always when they come in.
    apart_s: sensors whose clocks differ by more are said to be apart. silent_s: without a message for so long a sensor
    is lost. receive_bytes: the system's buffer of each UDP port, as far as it grants it.
    """

    lidar: LidarInput = LidarInput()
    imu: ImuInput | None = None
    gnss: GnssInput | None = None
    clock: ClockChoice = "auto"
    apart_s: Positive = 0.05
    silent_s: Positive = 2.0
    receive_bytes: Annotated[int, Field(ge=4096)] = 4 * 2**20
