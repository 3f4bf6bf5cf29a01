"""What a robot says first, checked before anything is opened for it."""

from __future__ import annotations

import math
import re
import uuid
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from map_service.store import Opening
from splitslam.errors import InputError
from splitslam.robot import Robot, robot_from_yaml
from splitslam.wire import session_pb2 as pb

WIRE_VERSION = 1
PARTS = frozenset({"loops", "gnss", "imu", "wheels"})
DESKEW = frozenset({"auto", "reference", "cpu", "fpga", "cosim", "off", "rotation"})
MAX_ROBOT_FILE_BYTES = 64 << 10
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,127}")


class RefusedError(Exception):
    """The stream will not be served. retry_after_ms 0: trying again does not help."""

    def __init__(self, reason: pb.RefusedReason, detail: str, retry_after_ms: int = 0) -> None:
        super().__init__(detail)
        self.message = pb.Refused(reason=reason, detail=detail, retry_after_ms=retry_after_ms)


@dataclass(frozen=True, slots=True, eq=False)
class SessionRequest:
    """A valid Hello. beam_elevations_rad: (rings,) float32."""

    opening: Opening
    robot: Robot
    beam_elevations_rad: NDArray[np.float32]
    codec_version: int
    deskew: str
    disable: frozenset[str]
    lockstep: bool

    @property
    def session_id(self) -> str:
        return self.opening.session_id


def session_id_of(hello: pb.Hello) -> str:
    """`robot_id/run_id`. Raises RefusedError for ids that cannot be a name, a path and a route key."""
    _check_name("robot_id", hello.robot_id)
    try:
        run_id = uuid.UUID(hello.run_id)
    except ValueError:
        run_id = None
    if run_id is None or str(run_id) != hello.run_id:
        raise _bad("run_id", hello.run_id, "a UUID in its 36-character lower-case form")
    return f"{hello.robot_id}/{hello.run_id}"


def read_hello(hello: pb.Hello, codec_version: int) -> SessionRequest:
    """Check everything a Hello says; `codec_version` is the highest this service decodes. Raises RefusedError."""
    if hello.wire_version != WIRE_VERSION:
        raise RefusedError(
            pb.REFUSED_REASON_VERSION, f"wire version {hello.wire_version}: this service speaks {WIRE_VERSION}"
        )
    if hello.codec_version < 1:
        raise RefusedError(
            pb.REFUSED_REASON_VERSION, f"codec version {hello.codec_version}: this service decodes 1 to {codec_version}"
        )
    session_id = session_id_of(hello)
    if hello.site_id:
        _check_name("site_id", hello.site_id)
    if hello.map_id:
        raise _bad("map_id", hello.map_id, "nothing: this service makes a new map for each session")
    unknown = sorted(set(hello.disable) - PARTS)
    if unknown:
        raise _bad("disable", unknown[0], f"one of {', '.join(sorted(PARTS))}")
    if hello.deskew not in DESKEW:
        raise _bad("deskew", hello.deskew, f"one of {', '.join(sorted(DESKEW))}")
    robot = _robot(hello)
    return SessionRequest(
        opening=Opening(session_id, hello.robot_id, hello.run_id, hello.site_id, hello.map_id, hello.robot_file_yaml),
        robot=robot,
        beam_elevations_rad=_beams(hello, robot),
        codec_version=hello.codec_version,
        deskew=hello.deskew,
        disable=frozenset(hello.disable),
        lockstep=hello.lockstep,
    )


def _robot(hello: pb.Hello) -> Robot:
    size = len(hello.robot_file_yaml)
    if size > MAX_ROBOT_FILE_BYTES:
        raise _bad("robot_file_yaml", f"{size} characters", f"at most {MAX_ROBOT_FILE_BYTES}")
    try:
        return robot_from_yaml(hello.robot_file_yaml)
    except InputError as error:
        raise RefusedError(pb.REFUSED_REASON_BAD_HELLO, f"robot_file_yaml: {error}") from error


def _beams(hello: pb.Hello, robot: Robot) -> NDArray[np.float32]:
    beams = np.array(hello.beam_elevations_rad, dtype=np.float32)
    if len(beams) != robot.lidar.rings:
        raise _bad("beam_elevations_rad", f"{len(beams)} values", f"one for each of {robot.lidar.rings} rings")
    if not np.all(np.abs(beams) <= math.pi / 2):  # also false for NaN
        raise _bad("beam_elevations_rad", "a value out of range", "elevations within +-pi/2")
    return beams


def _check_name(field: str, value: str) -> None:
    if not _NAME.fullmatch(value):
        raise _bad(field, value, "1 to 128 of A-Z a-z 0-9 . _ -, a letter or digit first")


def _bad(field: str, value: str, expected: str) -> RefusedError:
    return RefusedError(pb.REFUSED_REASON_BAD_HELLO, f"hello.{field} {value[:80]!r}: expected {expected}")
