from splitslam.wire import types_pb2 as _types_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from typing import ClassVar as _ClassVar, Iterable as _Iterable, Mapping as _Mapping, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class WatchRequest(_message.Message):
    __slots__ = ("max_rate_hz",)
    MAX_RATE_HZ_FIELD_NUMBER: _ClassVar[int]
    max_rate_hz: float
    def __init__(self, max_rate_hz: _Optional[float] = ...) -> None: ...

class WatchResponse(_message.Message):
    __slots__ = ("stamp_ns", "pose_odom_body", "pose_map_odom", "vx_mps", "vy_mps", "vz_mps", "covariance", "state")
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    POSE_ODOM_BODY_FIELD_NUMBER: _ClassVar[int]
    POSE_MAP_ODOM_FIELD_NUMBER: _ClassVar[int]
    VX_MPS_FIELD_NUMBER: _ClassVar[int]
    VY_MPS_FIELD_NUMBER: _ClassVar[int]
    VZ_MPS_FIELD_NUMBER: _ClassVar[int]
    COVARIANCE_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    pose_odom_body: _types_pb2.Transform
    pose_map_odom: _types_pb2.Transform
    vx_mps: float
    vy_mps: float
    vz_mps: float
    covariance: _containers.RepeatedScalarFieldContainer[float]
    state: _types_pb2.TrackingState
    def __init__(self, stamp_ns: _Optional[int] = ..., pose_odom_body: _Optional[_Union[_types_pb2.Transform, _Mapping]] = ..., pose_map_odom: _Optional[_Union[_types_pb2.Transform, _Mapping]] = ..., vx_mps: _Optional[float] = ..., vy_mps: _Optional[float] = ..., vz_mps: _Optional[float] = ..., covariance: _Optional[_Iterable[float]] = ..., state: _Optional[_Union[_types_pb2.TrackingState, str]] = ...) -> None: ...
