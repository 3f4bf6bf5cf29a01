"""Frames for a map service that is older than this agent: the codec version that it reads.

Recoding happens on the way out, so the spool keeps what was made, and a run may meet services of both versions.
"""

from __future__ import annotations

import logging

import numpy as np
from numpy.typing import NDArray

from splitslam import codec
from splitslam.codec import DecodeError
from splitslam.errors import InputError
from splitslam.logs import fields
from splitslam.robot import robot_from_yaml
from splitslam.wire import session_pb2 as pb

_log = logging.getLogger(__name__)


class Recoding:
    """Of one session's frames; `codec_version` is what the present service reads."""

    def __init__(self, hello: pb.Hello) -> None:
        """hello: what the frames of this session mean."""
        self._hello = hello
        self._columns: int | None = None
        self._beams_rad: NDArray[np.float32] = np.array(hello.beam_elevations_rad, np.float32)
        self.codec_version = codec.CODEC_VERSION

    def on_welcome(self, welcome: pb.Welcome) -> None:
        """Takes the service's version; it says 0 when it does not tell."""
        before, self.codec_version = self.codec_version, welcome.codec_version or codec.CODEC_VERSION
        if self.codec_version < min(before, codec.CODEC_VERSION):
            _log.warning("frames are recoded for an older map service", extra=fields(codec_version=self.codec_version))

    def readable(self, frame: pb.Frame) -> pb.Frame:
        """The frame as the service reads it, itself when it does already.

        One that cannot be recoded goes as it is: the service rejects it, and both sides count that.
        """
        if frame.codec_version <= self.codec_version or not frame.payload:
            return frame
        try:
            payload = codec.recode(frame.payload, self.codec_version, self._beams_rad, self._image_columns())
        except (DecodeError, InputError, ValueError) as error:
            said = fields(seq=frame.seq, codec_version=self.codec_version, detail=str(error))
            _log.warning("frame not recoded", extra=said)
            return frame
        again = pb.Frame()
        again.CopyFrom(frame)
        again.payload, again.codec_version = payload, self.codec_version
        return again

    def _image_columns(self) -> int:
        if self._columns is None:
            self._columns = robot_from_yaml(self._hello.robot_file_yaml).lidar.columns
        return self._columns
