"""All targets by name; each is made where it runs."""

from __future__ import annotations

from collections.abc import Callable

from tests.fuzz import recordings, sensors, storage, wire
from tests.fuzz.target import Target

TARGETS: dict[str, Callable[[], Target]] = {
    "codec": wire.codec,
    "messages": wire.messages,
    "robot_files": wire.robot_files,
    "forwarded": wire.forwarded,
    "uploads": wire.uploads,
    "spool_files": storage.spool_files,
    "clouds": storage.clouds,
    "dense_clouds": storage.dense_clouds,
    "store_rows": storage.store_rows,
    "packets": storage.packets,
    "point_clouds": storage.point_clouds,
    "recordings": recordings.recordings,
    "mip": sensors.mip,
    "nmea": sensors.nmea,
    "udp_packets": sensors.udp_packets,
    "captures": sensors.captures,
}
