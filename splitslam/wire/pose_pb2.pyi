from splitslam.wire import types_pb2 as _types_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from typing import ClassVar as _ClassVar, Iterable as _Iterable, Mapping as _Mapping, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class SessionSelection(_message.Message):
    __slots__ = ("session_ids", "robot_ids", "site_id")
    SESSION_IDS_FIELD_NUMBER: _ClassVar[int]
    ROBOT_IDS_FIELD_NUMBER: _ClassVar[int]
    SITE_ID_FIELD_NUMBER: _ClassVar[int]
    session_ids: _containers.RepeatedScalarFieldContainer[str]
    robot_ids: _containers.RepeatedScalarFieldContainer[str]
    site_id: str
    def __init__(self, session_ids: _Optional[_Iterable[str]] = ..., robot_ids: _Optional[_Iterable[str]] = ..., site_id: _Optional[str] = ...) -> None: ...

class WatchPosesRequest(_message.Message):
    __slots__ = ("sessions", "cursor", "after_seq", "from_start")
    class AfterSeqEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: int
        def __init__(self, key: _Optional[str] = ..., value: _Optional[int] = ...) -> None: ...
    SESSIONS_FIELD_NUMBER: _ClassVar[int]
    CURSOR_FIELD_NUMBER: _ClassVar[int]
    AFTER_SEQ_FIELD_NUMBER: _ClassVar[int]
    FROM_START_FIELD_NUMBER: _ClassVar[int]
    sessions: SessionSelection
    cursor: str
    after_seq: _containers.ScalarMap[str, int]
    from_start: bool
    def __init__(self, sessions: _Optional[_Union[SessionSelection, _Mapping]] = ..., cursor: _Optional[str] = ..., after_seq: _Optional[_Mapping[str, int]] = ..., from_start: bool = ...) -> None: ...

class ScanPose(_message.Message):
    __slots__ = ("session_id", "seq", "stamp_ns", "pose_map_lidar", "pose_map_body", "covariance", "state", "map_version", "keyframe", "thinned")
    SESSION_ID_FIELD_NUMBER: _ClassVar[int]
    SEQ_FIELD_NUMBER: _ClassVar[int]
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    POSE_MAP_LIDAR_FIELD_NUMBER: _ClassVar[int]
    POSE_MAP_BODY_FIELD_NUMBER: _ClassVar[int]
    COVARIANCE_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    MAP_VERSION_FIELD_NUMBER: _ClassVar[int]
    KEYFRAME_FIELD_NUMBER: _ClassVar[int]
    THINNED_FIELD_NUMBER: _ClassVar[int]
    session_id: str
    seq: int
    stamp_ns: int
    pose_map_lidar: _types_pb2.Transform
    pose_map_body: _types_pb2.Transform
    covariance: _containers.RepeatedScalarFieldContainer[float]
    state: _types_pb2.TrackingState
    map_version: int
    keyframe: bool
    thinned: bool
    def __init__(self, session_id: _Optional[str] = ..., seq: _Optional[int] = ..., stamp_ns: _Optional[int] = ..., pose_map_lidar: _Optional[_Union[_types_pb2.Transform, _Mapping]] = ..., pose_map_body: _Optional[_Union[_types_pb2.Transform, _Mapping]] = ..., covariance: _Optional[_Iterable[float]] = ..., state: _Optional[_Union[_types_pb2.TrackingState, str]] = ..., map_version: _Optional[int] = ..., keyframe: bool = ..., thinned: bool = ...) -> None: ...

class KeyframePose(_message.Message):
    __slots__ = ("keyframe", "seq", "stamp_ns", "pose_map_lidar")
    KEYFRAME_FIELD_NUMBER: _ClassVar[int]
    SEQ_FIELD_NUMBER: _ClassVar[int]
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    POSE_MAP_LIDAR_FIELD_NUMBER: _ClassVar[int]
    keyframe: int
    seq: int
    stamp_ns: int
    pose_map_lidar: _types_pb2.Transform
    def __init__(self, keyframe: _Optional[int] = ..., seq: _Optional[int] = ..., stamp_ns: _Optional[int] = ..., pose_map_lidar: _Optional[_Union[_types_pb2.Transform, _Mapping]] = ...) -> None: ...

class MapMove(_message.Message):
    __slots__ = ("map_version", "first_seq", "cause", "translation_m", "rotation_rad")
    MAP_VERSION_FIELD_NUMBER: _ClassVar[int]
    FIRST_SEQ_FIELD_NUMBER: _ClassVar[int]
    CAUSE_FIELD_NUMBER: _ClassVar[int]
    TRANSLATION_M_FIELD_NUMBER: _ClassVar[int]
    ROTATION_RAD_FIELD_NUMBER: _ClassVar[int]
    map_version: int
    first_seq: int
    cause: _types_pb2.CorrectionCause
    translation_m: float
    rotation_rad: float
    def __init__(self, map_version: _Optional[int] = ..., first_seq: _Optional[int] = ..., cause: _Optional[_Union[_types_pb2.CorrectionCause, str]] = ..., translation_m: _Optional[float] = ..., rotation_rad: _Optional[float] = ...) -> None: ...

class MovedKeyframes(_message.Message):
    __slots__ = ("session_id", "move", "keyframes", "more")
    SESSION_ID_FIELD_NUMBER: _ClassVar[int]
    MOVE_FIELD_NUMBER: _ClassVar[int]
    KEYFRAMES_FIELD_NUMBER: _ClassVar[int]
    MORE_FIELD_NUMBER: _ClassVar[int]
    session_id: str
    move: MapMove
    keyframes: _containers.RepeatedCompositeFieldContainer[KeyframePose]
    more: bool
    def __init__(self, session_id: _Optional[str] = ..., move: _Optional[_Union[MapMove, _Mapping]] = ..., keyframes: _Optional[_Iterable[_Union[KeyframePose, _Mapping]]] = ..., more: bool = ...) -> None: ...

class WatchPosesResponse(_message.Message):
    __slots__ = ("poses", "moved", "dropped", "cursor")
    POSES_FIELD_NUMBER: _ClassVar[int]
    MOVED_FIELD_NUMBER: _ClassVar[int]
    DROPPED_FIELD_NUMBER: _ClassVar[int]
    CURSOR_FIELD_NUMBER: _ClassVar[int]
    poses: _containers.RepeatedCompositeFieldContainer[ScanPose]
    moved: MovedKeyframes
    dropped: int
    cursor: str
    def __init__(self, poses: _Optional[_Iterable[_Union[ScanPose, _Mapping]]] = ..., moved: _Optional[_Union[MovedKeyframes, _Mapping]] = ..., dropped: _Optional[int] = ..., cursor: _Optional[str] = ...) -> None: ...

class PoseAtRequest(_message.Message):
    __slots__ = ("session_id", "stamp_ns", "map_version")
    SESSION_ID_FIELD_NUMBER: _ClassVar[int]
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    MAP_VERSION_FIELD_NUMBER: _ClassVar[int]
    session_id: str
    stamp_ns: int
    map_version: int
    def __init__(self, session_id: _Optional[str] = ..., stamp_ns: _Optional[int] = ..., map_version: _Optional[int] = ...) -> None: ...

class PoseAtResponse(_message.Message):
    __slots__ = ("pose_map_lidar", "pose_map_body", "covariance", "state", "map_version", "newest_map_version", "oldest_map_version", "seq_before", "seq_after", "thinned")
    POSE_MAP_LIDAR_FIELD_NUMBER: _ClassVar[int]
    POSE_MAP_BODY_FIELD_NUMBER: _ClassVar[int]
    COVARIANCE_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    MAP_VERSION_FIELD_NUMBER: _ClassVar[int]
    NEWEST_MAP_VERSION_FIELD_NUMBER: _ClassVar[int]
    OLDEST_MAP_VERSION_FIELD_NUMBER: _ClassVar[int]
    SEQ_BEFORE_FIELD_NUMBER: _ClassVar[int]
    SEQ_AFTER_FIELD_NUMBER: _ClassVar[int]
    THINNED_FIELD_NUMBER: _ClassVar[int]
    pose_map_lidar: _types_pb2.Transform
    pose_map_body: _types_pb2.Transform
    covariance: _containers.RepeatedScalarFieldContainer[float]
    state: _types_pb2.TrackingState
    map_version: int
    newest_map_version: int
    oldest_map_version: int
    seq_before: int
    seq_after: int
    thinned: bool
    def __init__(self, pose_map_lidar: _Optional[_Union[_types_pb2.Transform, _Mapping]] = ..., pose_map_body: _Optional[_Union[_types_pb2.Transform, _Mapping]] = ..., covariance: _Optional[_Iterable[float]] = ..., state: _Optional[_Union[_types_pb2.TrackingState, str]] = ..., map_version: _Optional[int] = ..., newest_map_version: _Optional[int] = ..., oldest_map_version: _Optional[int] = ..., seq_before: _Optional[int] = ..., seq_after: _Optional[int] = ..., thinned: bool = ...) -> None: ...

class LocalMapRequest(_message.Message):
    __slots__ = ("session_id", "pose_map_lidar", "radius_m", "voxel_m", "max_points")
    SESSION_ID_FIELD_NUMBER: _ClassVar[int]
    POSE_MAP_LIDAR_FIELD_NUMBER: _ClassVar[int]
    RADIUS_M_FIELD_NUMBER: _ClassVar[int]
    VOXEL_M_FIELD_NUMBER: _ClassVar[int]
    MAX_POINTS_FIELD_NUMBER: _ClassVar[int]
    session_id: str
    pose_map_lidar: _types_pb2.Transform
    radius_m: float
    voxel_m: float
    max_points: int
    def __init__(self, session_id: _Optional[str] = ..., pose_map_lidar: _Optional[_Union[_types_pb2.Transform, _Mapping]] = ..., radius_m: _Optional[float] = ..., voxel_m: _Optional[float] = ..., max_points: _Optional[int] = ...) -> None: ...

class LocalMapResponse(_message.Message):
    __slots__ = ("keyframe", "pose_map_lidar", "points", "point_count", "map_version", "truncated")
    KEYFRAME_FIELD_NUMBER: _ClassVar[int]
    POSE_MAP_LIDAR_FIELD_NUMBER: _ClassVar[int]
    POINTS_FIELD_NUMBER: _ClassVar[int]
    POINT_COUNT_FIELD_NUMBER: _ClassVar[int]
    MAP_VERSION_FIELD_NUMBER: _ClassVar[int]
    TRUNCATED_FIELD_NUMBER: _ClassVar[int]
    keyframe: int
    pose_map_lidar: _types_pb2.Transform
    points: bytes
    point_count: int
    map_version: int
    truncated: bool
    def __init__(self, keyframe: _Optional[int] = ..., pose_map_lidar: _Optional[_Union[_types_pb2.Transform, _Mapping]] = ..., points: _Optional[bytes] = ..., point_count: _Optional[int] = ..., map_version: _Optional[int] = ..., truncated: bool = ...) -> None: ...

class EventsRequest(_message.Message):
    __slots__ = ("sessions", "cursor", "from_start")
    SESSIONS_FIELD_NUMBER: _ClassVar[int]
    CURSOR_FIELD_NUMBER: _ClassVar[int]
    FROM_START_FIELD_NUMBER: _ClassVar[int]
    sessions: SessionSelection
    cursor: str
    from_start: bool
    def __init__(self, sessions: _Optional[_Union[SessionSelection, _Mapping]] = ..., cursor: _Optional[str] = ..., from_start: bool = ...) -> None: ...

class SessionOpened(_message.Message):
    __slots__ = ("epoch",)
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    epoch: int
    def __init__(self, epoch: _Optional[int] = ...) -> None: ...

class SessionEnded(_message.Message):
    __slots__ = ("scans",)
    SCANS_FIELD_NUMBER: _ClassVar[int]
    scans: int
    def __init__(self, scans: _Optional[int] = ...) -> None: ...

class StateChange(_message.Message):
    __slots__ = ("before", "after")
    BEFORE_FIELD_NUMBER: _ClassVar[int]
    AFTER_FIELD_NUMBER: _ClassVar[int]
    before: _types_pb2.TrackingState
    after: _types_pb2.TrackingState
    def __init__(self, before: _Optional[_Union[_types_pb2.TrackingState, str]] = ..., after: _Optional[_Union[_types_pb2.TrackingState, str]] = ...) -> None: ...

class LoopAccepted(_message.Message):
    __slots__ = ("older_keyframe", "newer_keyframe", "translation_m", "rotation_rad")
    OLDER_KEYFRAME_FIELD_NUMBER: _ClassVar[int]
    NEWER_KEYFRAME_FIELD_NUMBER: _ClassVar[int]
    TRANSLATION_M_FIELD_NUMBER: _ClassVar[int]
    ROTATION_RAD_FIELD_NUMBER: _ClassVar[int]
    older_keyframe: int
    newer_keyframe: int
    translation_m: float
    rotation_rad: float
    def __init__(self, older_keyframe: _Optional[int] = ..., newer_keyframe: _Optional[int] = ..., translation_m: _Optional[float] = ..., rotation_rad: _Optional[float] = ...) -> None: ...

class LoopsRejected(_message.Message):
    __slots__ = ("reason", "count")
    REASON_FIELD_NUMBER: _ClassVar[int]
    COUNT_FIELD_NUMBER: _ClassVar[int]
    reason: str
    count: int
    def __init__(self, reason: _Optional[str] = ..., count: _Optional[int] = ...) -> None: ...

class GnssDatumFound(_message.Message):
    __slots__ = ("datum", "latitude_deg", "longitude_deg", "altitude_m", "pose_enu_map")
    DATUM_FIELD_NUMBER: _ClassVar[int]
    LATITUDE_DEG_FIELD_NUMBER: _ClassVar[int]
    LONGITUDE_DEG_FIELD_NUMBER: _ClassVar[int]
    ALTITUDE_M_FIELD_NUMBER: _ClassVar[int]
    POSE_ENU_MAP_FIELD_NUMBER: _ClassVar[int]
    datum: int
    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    pose_enu_map: _types_pb2.Transform
    def __init__(self, datum: _Optional[int] = ..., latitude_deg: _Optional[float] = ..., longitude_deg: _Optional[float] = ..., altitude_m: _Optional[float] = ..., pose_enu_map: _Optional[_Union[_types_pb2.Transform, _Mapping]] = ...) -> None: ...

class Event(_message.Message):
    __slots__ = ("session_id", "number", "seq", "stamp_ns", "opened", "ended", "state", "correction", "map", "loop", "loops_rejected", "gnss_datum")
    SESSION_ID_FIELD_NUMBER: _ClassVar[int]
    NUMBER_FIELD_NUMBER: _ClassVar[int]
    SEQ_FIELD_NUMBER: _ClassVar[int]
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    OPENED_FIELD_NUMBER: _ClassVar[int]
    ENDED_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    CORRECTION_FIELD_NUMBER: _ClassVar[int]
    MAP_FIELD_NUMBER: _ClassVar[int]
    LOOP_FIELD_NUMBER: _ClassVar[int]
    LOOPS_REJECTED_FIELD_NUMBER: _ClassVar[int]
    GNSS_DATUM_FIELD_NUMBER: _ClassVar[int]
    session_id: str
    number: int
    seq: int
    stamp_ns: int
    opened: SessionOpened
    ended: SessionEnded
    state: StateChange
    correction: _types_pb2.Correction
    map: MapMove
    loop: LoopAccepted
    loops_rejected: LoopsRejected
    gnss_datum: GnssDatumFound
    def __init__(self, session_id: _Optional[str] = ..., number: _Optional[int] = ..., seq: _Optional[int] = ..., stamp_ns: _Optional[int] = ..., opened: _Optional[_Union[SessionOpened, _Mapping]] = ..., ended: _Optional[_Union[SessionEnded, _Mapping]] = ..., state: _Optional[_Union[StateChange, _Mapping]] = ..., correction: _Optional[_Union[_types_pb2.Correction, _Mapping]] = ..., map: _Optional[_Union[MapMove, _Mapping]] = ..., loop: _Optional[_Union[LoopAccepted, _Mapping]] = ..., loops_rejected: _Optional[_Union[LoopsRejected, _Mapping]] = ..., gnss_datum: _Optional[_Union[GnssDatumFound, _Mapping]] = ...) -> None: ...

class EventsResponse(_message.Message):
    __slots__ = ("events", "cursor", "lost")
    EVENTS_FIELD_NUMBER: _ClassVar[int]
    CURSOR_FIELD_NUMBER: _ClassVar[int]
    LOST_FIELD_NUMBER: _ClassVar[int]
    events: _containers.RepeatedCompositeFieldContainer[Event]
    cursor: str
    lost: int
    def __init__(self, events: _Optional[_Iterable[_Union[Event, _Mapping]]] = ..., cursor: _Optional[str] = ..., lost: _Optional[int] = ...) -> None: ...
