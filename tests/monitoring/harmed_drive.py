"""A made drive, and the same as a robot records it whose IMU is bad: silent for a while, NaN, a clock that steps."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Writer

from splitslam.chaos.agent import Drive
from splitslam.sim import DEMO, simulate

SECONDS = 38.0
# Late: what is there when a page is read for the first time, on a busy machine, is no rise.
_SILENT_S = (12.0, 15.0)  # longer than scans wait for their IMU
_NAN_S = (16.0, 16.02)
_STEP_S, _STEP_BY_S = 19.0, 3600
# sensor_msgs/Imu in ROS 1: Header{seq, stamp, frame}, orientation and covariance, gyro, ...
_SECONDS, _LENGTH, _X = struct.Struct("<I"), struct.Struct("<I"), struct.Struct("<d")
_SECONDS_AT_BYTE, _NAME_AT_BYTE = 4, 12


def make(folder: Path) -> Drive:
    """The demo's drive, cut short."""
    made = simulate(replace(DEMO, duration_s=SECONDS), folder)
    return Drive(made.bag_path, made.robot_path, made.truth_path)


def harm(drive: Drive, folder: Path) -> Drive:
    """Its recording with a bad IMU, and a robot file that is wrong about the rate of it."""
    folder.mkdir()
    harmed = Drive(folder / drive.recording.name, folder / drive.robot.name, drive.truth)
    robot = yaml.safe_load(drive.robot.read_text())
    robot["imu"]["rate_hz"] = 100.0
    harmed.robot.write_text(yaml.safe_dump(robot))
    with AnyReader([drive.recording]) as bag, Writer(harmed.recording) as out:
        connections = {
            one.topic: out.add_connection(one.topic, one.msgtype, typestore=bag.typestore) for one in bag.connections
        }
        start_ns = bag.start_time
        for connection, at_ns, raw in bag.messages():
            messages = [bytes(raw)]
            if connection.topic == "/imu/data":
                messages = list(_bad_imu(messages[0], (at_ns - start_ns) * 1e-9))
            for message in messages:
                out.write(connections[connection.topic], at_ns, message)
    return harmed


def _bad_imu(raw: bytes, after_s: float) -> Iterator[bytes]:
    """What becomes of one message."""
    if _SILENT_S[0] <= after_s < _SILENT_S[1]:
        return
    message = bytearray(raw)
    if after_s >= _STEP_S:
        seconds = _SECONDS.unpack_from(message, _SECONDS_AT_BYTE)[0]
        _SECONDS.pack_into(message, _SECONDS_AT_BYTE, seconds + _STEP_BY_S)
    if _NAN_S[0] <= after_s < _NAN_S[1]:
        name_bytes = _LENGTH.unpack_from(message, _NAME_AT_BYTE)[0]
        gyro = _NAME_AT_BYTE + _LENGTH.size + name_bytes + (4 + 9) * _X.size  # behind the orientation, its covariance
        _X.pack_into(message, gyro, np.nan)
    yield bytes(message)
