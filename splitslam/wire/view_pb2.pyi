from splitslam.wire import session_pb2 as _session_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from typing import ClassVar as _ClassVar, Iterable as _Iterable, Mapping as _Mapping, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class WatchScansRequest(_message.Message):
    __slots__ = ("robot_id", "site_id")
    ROBOT_ID_FIELD_NUMBER: _ClassVar[int]
    SITE_ID_FIELD_NUMBER: _ClassVar[int]
    robot_id: str
    site_id: str
    def __init__(self, robot_id: _Optional[str] = ..., site_id: _Optional[str] = ...) -> None: ...

class ScanSeen(_message.Message):
    __slots__ = ("answer", "keyframe", "corners_lidar", "surfs_lidar", "corner_matches_lidar", "surf_matches_lidar", "frame_bytes", "dense", "registration_ms")
    ANSWER_FIELD_NUMBER: _ClassVar[int]
    KEYFRAME_FIELD_NUMBER: _ClassVar[int]
    CORNERS_LIDAR_FIELD_NUMBER: _ClassVar[int]
    SURFS_LIDAR_FIELD_NUMBER: _ClassVar[int]
    CORNER_MATCHES_LIDAR_FIELD_NUMBER: _ClassVar[int]
    SURF_MATCHES_LIDAR_FIELD_NUMBER: _ClassVar[int]
    FRAME_BYTES_FIELD_NUMBER: _ClassVar[int]
    DENSE_FIELD_NUMBER: _ClassVar[int]
    REGISTRATION_MS_FIELD_NUMBER: _ClassVar[int]
    answer: _session_pb2.Odometry
    keyframe: int
    corners_lidar: bytes
    surfs_lidar: bytes
    corner_matches_lidar: bytes
    surf_matches_lidar: bytes
    frame_bytes: int
    dense: bool
    registration_ms: float
    def __init__(self, answer: _Optional[_Union[_session_pb2.Odometry, _Mapping]] = ..., keyframe: _Optional[int] = ..., corners_lidar: _Optional[bytes] = ..., surfs_lidar: _Optional[bytes] = ..., corner_matches_lidar: _Optional[bytes] = ..., surf_matches_lidar: _Optional[bytes] = ..., frame_bytes: _Optional[int] = ..., dense: bool = ..., registration_ms: _Optional[float] = ...) -> None: ...

class MapSeen(_message.Message):
    __slots__ = ("keyframes", "poses_map_lidar", "loops", "fix_keyframes", "fixes_map")
    KEYFRAMES_FIELD_NUMBER: _ClassVar[int]
    POSES_MAP_LIDAR_FIELD_NUMBER: _ClassVar[int]
    LOOPS_FIELD_NUMBER: _ClassVar[int]
    FIX_KEYFRAMES_FIELD_NUMBER: _ClassVar[int]
    FIXES_MAP_FIELD_NUMBER: _ClassVar[int]
    keyframes: _containers.RepeatedScalarFieldContainer[int]
    poses_map_lidar: bytes
    loops: _containers.RepeatedScalarFieldContainer[int]
    fix_keyframes: _containers.RepeatedScalarFieldContainer[int]
    fixes_map: bytes
    def __init__(self, keyframes: _Optional[_Iterable[int]] = ..., poses_map_lidar: _Optional[bytes] = ..., loops: _Optional[_Iterable[int]] = ..., fix_keyframes: _Optional[_Iterable[int]] = ..., fixes_map: _Optional[bytes] = ...) -> None: ...

class WatchScansResponse(_message.Message):
    __slots__ = ("session_id", "site_id", "scan", "map", "answer_ms", "missed", "replicas", "replica")
    SESSION_ID_FIELD_NUMBER: _ClassVar[int]
    SITE_ID_FIELD_NUMBER: _ClassVar[int]
    SCAN_FIELD_NUMBER: _ClassVar[int]
    MAP_FIELD_NUMBER: _ClassVar[int]
    ANSWER_MS_FIELD_NUMBER: _ClassVar[int]
    MISSED_FIELD_NUMBER: _ClassVar[int]
    REPLICAS_FIELD_NUMBER: _ClassVar[int]
    REPLICA_FIELD_NUMBER: _ClassVar[int]
    session_id: str
    site_id: str
    scan: ScanSeen
    map: MapSeen
    answer_ms: float
    missed: int
    replicas: _containers.RepeatedScalarFieldContainer[str]
    replica: str
    def __init__(self, session_id: _Optional[str] = ..., site_id: _Optional[str] = ..., scan: _Optional[_Union[ScanSeen, _Mapping]] = ..., map: _Optional[_Union[MapSeen, _Mapping]] = ..., answer_ms: _Optional[float] = ..., missed: _Optional[int] = ..., replicas: _Optional[_Iterable[str]] = ..., replica: _Optional[str] = ...) -> None: ...
