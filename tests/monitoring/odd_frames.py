"""Frames of a drive after which a map service has something to complain about."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from splitslam import codec
from splitslam.features import FeatureSet
from splitslam.stack.reel import Reel
from splitslam.wire import session_pb2 as pb

_COLUMNS = 1800
_FLOOR_M = -1.3  # what lies lower than this in frame `lidar` is the ground, for a sensor 1.5 m above it


def only_the_floor(reel: Reel, after: int) -> Reel:
    """From frame `after` on the robot sees a plane alone: not where on it, nor which way it looks; soon it is lost."""
    beams = np.array(reel.hello.beam_elevations_rad, np.float32)
    frames = [_copy(frame) for frame in reel.frames]
    for frame in frames[after:]:
        seen = codec.decode(frame.payload, frame.seq, frame.stamp_ns, frame.dense, beams)
        bare = replace(seen, corners=_lying_low(seen.corners), surfs=_lying_low(seen.surfs))
        frame.payload = codec.encode(bare, beams, _COLUMNS)
    return Reel(reel.hello, frames)


def flipped(frame: pb.Frame) -> pb.Frame:
    """A bit of the payload is another."""
    other, payload = _copy(frame), bytearray(frame.payload)
    payload[len(payload) // 2] ^= 0x10
    other.payload = bytes(payload)
    return other


def _copy(frame: pb.Frame) -> pb.Frame:
    other = pb.Frame()
    other.CopyFrom(frame)
    return other


def _lying_low(features: FeatureSet) -> FeatureSet:
    kept = features.points_lidar[:, 2] < _FLOOR_M
    names = ("points_lidar", "ring", "column", "t_offset_ns", "intensity")
    return FeatureSet(*(getattr(features, name)[kept] for name in names))
