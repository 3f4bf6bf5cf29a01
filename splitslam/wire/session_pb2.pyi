from splitslam.wire import types_pb2 as _types_pb2
from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from typing import ClassVar as _ClassVar, Iterable as _Iterable, Mapping as _Mapping, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class DrainReason(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    DRAIN_REASON_UNSPECIFIED: _ClassVar[DrainReason]
    DRAIN_REASON_SHUTDOWN: _ClassVar[DrainReason]
    DRAIN_REASON_REBALANCE: _ClassVar[DrainReason]

class RefusedReason(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    REFUSED_REASON_UNSPECIFIED: _ClassVar[RefusedReason]
    REFUSED_REASON_OVERLOADED: _ClassVar[RefusedReason]
    REFUSED_REASON_UNAUTHENTICATED: _ClassVar[RefusedReason]
    REFUSED_REASON_VERSION: _ClassVar[RefusedReason]
    REFUSED_REASON_QUOTA: _ClassVar[RefusedReason]
    REFUSED_REASON_FINISHED: _ClassVar[RefusedReason]
    REFUSED_REASON_BAD_HELLO: _ClassVar[RefusedReason]
    REFUSED_REASON_FENCED: _ClassVar[RefusedReason]
    REFUSED_REASON_STORE: _ClassVar[RefusedReason]
DRAIN_REASON_UNSPECIFIED: DrainReason
DRAIN_REASON_SHUTDOWN: DrainReason
DRAIN_REASON_REBALANCE: DrainReason
REFUSED_REASON_UNSPECIFIED: RefusedReason
REFUSED_REASON_OVERLOADED: RefusedReason
REFUSED_REASON_UNAUTHENTICATED: RefusedReason
REFUSED_REASON_VERSION: RefusedReason
REFUSED_REASON_QUOTA: RefusedReason
REFUSED_REASON_FINISHED: RefusedReason
REFUSED_REASON_BAD_HELLO: RefusedReason
REFUSED_REASON_FENCED: RefusedReason
REFUSED_REASON_STORE: RefusedReason

class Hello(_message.Message):
    __slots__ = ("robot_id", "run_id", "robot_file_yaml", "beam_elevations_rad", "wire_version", "codec_version", "site_id", "map_id", "attempt", "agent_version", "deskew", "disable", "lockstep")
    ROBOT_ID_FIELD_NUMBER: _ClassVar[int]
    RUN_ID_FIELD_NUMBER: _ClassVar[int]
    ROBOT_FILE_YAML_FIELD_NUMBER: _ClassVar[int]
    BEAM_ELEVATIONS_RAD_FIELD_NUMBER: _ClassVar[int]
    WIRE_VERSION_FIELD_NUMBER: _ClassVar[int]
    CODEC_VERSION_FIELD_NUMBER: _ClassVar[int]
    SITE_ID_FIELD_NUMBER: _ClassVar[int]
    MAP_ID_FIELD_NUMBER: _ClassVar[int]
    ATTEMPT_FIELD_NUMBER: _ClassVar[int]
    AGENT_VERSION_FIELD_NUMBER: _ClassVar[int]
    DESKEW_FIELD_NUMBER: _ClassVar[int]
    DISABLE_FIELD_NUMBER: _ClassVar[int]
    LOCKSTEP_FIELD_NUMBER: _ClassVar[int]
    robot_id: str
    run_id: str
    robot_file_yaml: str
    beam_elevations_rad: _containers.RepeatedScalarFieldContainer[float]
    wire_version: int
    codec_version: int
    site_id: str
    map_id: str
    attempt: int
    agent_version: str
    deskew: str
    disable: _containers.RepeatedScalarFieldContainer[str]
    lockstep: bool
    def __init__(self, robot_id: _Optional[str] = ..., run_id: _Optional[str] = ..., robot_file_yaml: _Optional[str] = ..., beam_elevations_rad: _Optional[_Iterable[float]] = ..., wire_version: _Optional[int] = ..., codec_version: _Optional[int] = ..., site_id: _Optional[str] = ..., map_id: _Optional[str] = ..., attempt: _Optional[int] = ..., agent_version: _Optional[str] = ..., deskew: _Optional[str] = ..., disable: _Optional[_Iterable[str]] = ..., lockstep: bool = ...) -> None: ...

class Frame(_message.Message):
    __slots__ = ("seq", "stamp_ns", "dense", "codec_version", "payload", "fixes", "wheel", "trace_id", "follows_seq")
    SEQ_FIELD_NUMBER: _ClassVar[int]
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    DENSE_FIELD_NUMBER: _ClassVar[int]
    CODEC_VERSION_FIELD_NUMBER: _ClassVar[int]
    PAYLOAD_FIELD_NUMBER: _ClassVar[int]
    FIXES_FIELD_NUMBER: _ClassVar[int]
    WHEEL_FIELD_NUMBER: _ClassVar[int]
    TRACE_ID_FIELD_NUMBER: _ClassVar[int]
    FOLLOWS_SEQ_FIELD_NUMBER: _ClassVar[int]
    seq: int
    stamp_ns: int
    dense: bool
    codec_version: int
    payload: bytes
    fixes: _containers.RepeatedCompositeFieldContainer[_types_pb2.GnssFix]
    wheel: _types_pb2.WheelMotion
    trace_id: str
    follows_seq: int
    def __init__(self, seq: _Optional[int] = ..., stamp_ns: _Optional[int] = ..., dense: bool = ..., codec_version: _Optional[int] = ..., payload: _Optional[bytes] = ..., fixes: _Optional[_Iterable[_Union[_types_pb2.GnssFix, _Mapping]]] = ..., wheel: _Optional[_Union[_types_pb2.WheelMotion, _Mapping]] = ..., trace_id: _Optional[str] = ..., follows_seq: _Optional[int] = ...) -> None: ...

class Bye(_message.Message):
    __slots__ = ("last_seq",)
    LAST_SEQ_FIELD_NUMBER: _ClassVar[int]
    last_seq: int
    def __init__(self, last_seq: _Optional[int] = ...) -> None: ...

class EdgeReport(_message.Message):
    __slots__ = ("dropped_by_reason", "spool_frames", "spool_bytes")
    class DroppedByReasonEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: int
        def __init__(self, key: _Optional[str] = ..., value: _Optional[int] = ...) -> None: ...
    DROPPED_BY_REASON_FIELD_NUMBER: _ClassVar[int]
    SPOOL_FRAMES_FIELD_NUMBER: _ClassVar[int]
    SPOOL_BYTES_FIELD_NUMBER: _ClassVar[int]
    dropped_by_reason: _containers.ScalarMap[str, int]
    spool_frames: int
    spool_bytes: int
    def __init__(self, dropped_by_reason: _Optional[_Mapping[str, int]] = ..., spool_frames: _Optional[int] = ..., spool_bytes: _Optional[int] = ...) -> None: ...

class StreamRequest(_message.Message):
    __slots__ = ("hello", "frame", "bye", "report")
    HELLO_FIELD_NUMBER: _ClassVar[int]
    FRAME_FIELD_NUMBER: _ClassVar[int]
    BYE_FIELD_NUMBER: _ClassVar[int]
    REPORT_FIELD_NUMBER: _ClassVar[int]
    hello: Hello
    frame: Frame
    bye: Bye
    report: EdgeReport
    def __init__(self, hello: _Optional[_Union[Hello, _Mapping]] = ..., frame: _Optional[_Union[Frame, _Mapping]] = ..., bye: _Optional[_Union[Bye, _Mapping]] = ..., report: _Optional[_Union[EdgeReport, _Mapping]] = ...) -> None: ...

class Welcome(_message.Message):
    __slots__ = ("epoch", "durable_seq", "applied_seq", "last_poses", "pose_map_odom", "wire_version", "codec_version", "session_id", "service_version", "takes_dense")
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    DURABLE_SEQ_FIELD_NUMBER: _ClassVar[int]
    APPLIED_SEQ_FIELD_NUMBER: _ClassVar[int]
    LAST_POSES_FIELD_NUMBER: _ClassVar[int]
    POSE_MAP_ODOM_FIELD_NUMBER: _ClassVar[int]
    WIRE_VERSION_FIELD_NUMBER: _ClassVar[int]
    CODEC_VERSION_FIELD_NUMBER: _ClassVar[int]
    SESSION_ID_FIELD_NUMBER: _ClassVar[int]
    SERVICE_VERSION_FIELD_NUMBER: _ClassVar[int]
    TAKES_DENSE_FIELD_NUMBER: _ClassVar[int]
    epoch: int
    durable_seq: int
    applied_seq: int
    last_poses: _containers.RepeatedCompositeFieldContainer[_types_pb2.StampedPose]
    pose_map_odom: _types_pb2.Transform
    wire_version: int
    codec_version: int
    session_id: str
    service_version: str
    takes_dense: bool
    def __init__(self, epoch: _Optional[int] = ..., durable_seq: _Optional[int] = ..., applied_seq: _Optional[int] = ..., last_poses: _Optional[_Iterable[_Union[_types_pb2.StampedPose, _Mapping]]] = ..., pose_map_odom: _Optional[_Union[_types_pb2.Transform, _Mapping]] = ..., wire_version: _Optional[int] = ..., codec_version: _Optional[int] = ..., session_id: _Optional[str] = ..., service_version: _Optional[str] = ..., takes_dense: bool = ...) -> None: ...

class Odometry(_message.Message):
    __slots__ = ("seq", "stamp_ns", "pose_map_lidar", "pose_map_odom", "covariance", "state", "degenerate_axes", "correction", "applied_seq", "durable_seq", "keyframe", "duplicate", "rejected", "map_version")
    SEQ_FIELD_NUMBER: _ClassVar[int]
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    POSE_MAP_LIDAR_FIELD_NUMBER: _ClassVar[int]
    POSE_MAP_ODOM_FIELD_NUMBER: _ClassVar[int]
    COVARIANCE_FIELD_NUMBER: _ClassVar[int]
    STATE_FIELD_NUMBER: _ClassVar[int]
    DEGENERATE_AXES_FIELD_NUMBER: _ClassVar[int]
    CORRECTION_FIELD_NUMBER: _ClassVar[int]
    APPLIED_SEQ_FIELD_NUMBER: _ClassVar[int]
    DURABLE_SEQ_FIELD_NUMBER: _ClassVar[int]
    KEYFRAME_FIELD_NUMBER: _ClassVar[int]
    DUPLICATE_FIELD_NUMBER: _ClassVar[int]
    REJECTED_FIELD_NUMBER: _ClassVar[int]
    MAP_VERSION_FIELD_NUMBER: _ClassVar[int]
    seq: int
    stamp_ns: int
    pose_map_lidar: _types_pb2.Transform
    pose_map_odom: _types_pb2.Transform
    covariance: _containers.RepeatedScalarFieldContainer[float]
    state: _types_pb2.TrackingState
    degenerate_axes: _containers.RepeatedScalarFieldContainer[float]
    correction: _types_pb2.Correction
    applied_seq: int
    durable_seq: int
    keyframe: bool
    duplicate: bool
    rejected: str
    map_version: int
    def __init__(self, seq: _Optional[int] = ..., stamp_ns: _Optional[int] = ..., pose_map_lidar: _Optional[_Union[_types_pb2.Transform, _Mapping]] = ..., pose_map_odom: _Optional[_Union[_types_pb2.Transform, _Mapping]] = ..., covariance: _Optional[_Iterable[float]] = ..., state: _Optional[_Union[_types_pb2.TrackingState, str]] = ..., degenerate_axes: _Optional[_Iterable[float]] = ..., correction: _Optional[_Union[_types_pb2.Correction, _Mapping]] = ..., applied_seq: _Optional[int] = ..., durable_seq: _Optional[int] = ..., keyframe: bool = ..., duplicate: bool = ..., rejected: _Optional[str] = ..., map_version: _Optional[int] = ...) -> None: ...

class Credit(_message.Message):
    __slots__ = ("window", "durable_seq")
    WINDOW_FIELD_NUMBER: _ClassVar[int]
    DURABLE_SEQ_FIELD_NUMBER: _ClassVar[int]
    window: int
    durable_seq: int
    def __init__(self, window: _Optional[int] = ..., durable_seq: _Optional[int] = ...) -> None: ...

class Advice(_message.Message):
    __slots__ = ("max_kbps", "want_dense")
    MAX_KBPS_FIELD_NUMBER: _ClassVar[int]
    WANT_DENSE_FIELD_NUMBER: _ClassVar[int]
    max_kbps: int
    want_dense: bool
    def __init__(self, max_kbps: _Optional[int] = ..., want_dense: bool = ...) -> None: ...

class Drain(_message.Message):
    __slots__ = ("reason", "retry_after_ms", "replica")
    REASON_FIELD_NUMBER: _ClassVar[int]
    RETRY_AFTER_MS_FIELD_NUMBER: _ClassVar[int]
    REPLICA_FIELD_NUMBER: _ClassVar[int]
    reason: DrainReason
    retry_after_ms: int
    replica: str
    def __init__(self, reason: _Optional[_Union[DrainReason, str]] = ..., retry_after_ms: _Optional[int] = ..., replica: _Optional[str] = ...) -> None: ...

class Refused(_message.Message):
    __slots__ = ("reason", "detail", "retry_after_ms")
    REASON_FIELD_NUMBER: _ClassVar[int]
    DETAIL_FIELD_NUMBER: _ClassVar[int]
    RETRY_AFTER_MS_FIELD_NUMBER: _ClassVar[int]
    reason: RefusedReason
    detail: str
    retry_after_ms: int
    def __init__(self, reason: _Optional[_Union[RefusedReason, str]] = ..., detail: _Optional[str] = ..., retry_after_ms: _Optional[int] = ...) -> None: ...

class Finished(_message.Message):
    __slots__ = ("mapped", "keyframes", "loops", "gnss_factors")
    MAPPED_FIELD_NUMBER: _ClassVar[int]
    KEYFRAMES_FIELD_NUMBER: _ClassVar[int]
    LOOPS_FIELD_NUMBER: _ClassVar[int]
    GNSS_FACTORS_FIELD_NUMBER: _ClassVar[int]
    mapped: int
    keyframes: int
    loops: int
    gnss_factors: int
    def __init__(self, mapped: _Optional[int] = ..., keyframes: _Optional[int] = ..., loops: _Optional[int] = ..., gnss_factors: _Optional[int] = ...) -> None: ...

class StreamResponse(_message.Message):
    __slots__ = ("welcome", "odometry", "credit", "advice", "drain", "refused", "finished")
    WELCOME_FIELD_NUMBER: _ClassVar[int]
    ODOMETRY_FIELD_NUMBER: _ClassVar[int]
    CREDIT_FIELD_NUMBER: _ClassVar[int]
    ADVICE_FIELD_NUMBER: _ClassVar[int]
    DRAIN_FIELD_NUMBER: _ClassVar[int]
    REFUSED_FIELD_NUMBER: _ClassVar[int]
    FINISHED_FIELD_NUMBER: _ClassVar[int]
    welcome: Welcome
    odometry: Odometry
    credit: Credit
    advice: Advice
    drain: Drain
    refused: Refused
    finished: Finished
    def __init__(self, welcome: _Optional[_Union[Welcome, _Mapping]] = ..., odometry: _Optional[_Union[Odometry, _Mapping]] = ..., credit: _Optional[_Union[Credit, _Mapping]] = ..., advice: _Optional[_Union[Advice, _Mapping]] = ..., drain: _Optional[_Union[Drain, _Mapping]] = ..., refused: _Optional[_Union[Refused, _Mapping]] = ..., finished: _Optional[_Union[Finished, _Mapping]] = ...) -> None: ...

class SessionInfo(_message.Message):
    __slots__ = ("session_id", "robot_id", "run_id", "site_id", "map_id", "finished", "epoch", "durable_seq", "first_stamp_ns", "last_stamp_ns", "frames", "keyframes", "loops", "gnss_factors", "store_bytes", "statistics_json")
    SESSION_ID_FIELD_NUMBER: _ClassVar[int]
    ROBOT_ID_FIELD_NUMBER: _ClassVar[int]
    RUN_ID_FIELD_NUMBER: _ClassVar[int]
    SITE_ID_FIELD_NUMBER: _ClassVar[int]
    MAP_ID_FIELD_NUMBER: _ClassVar[int]
    FINISHED_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    DURABLE_SEQ_FIELD_NUMBER: _ClassVar[int]
    FIRST_STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    LAST_STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    FRAMES_FIELD_NUMBER: _ClassVar[int]
    KEYFRAMES_FIELD_NUMBER: _ClassVar[int]
    LOOPS_FIELD_NUMBER: _ClassVar[int]
    GNSS_FACTORS_FIELD_NUMBER: _ClassVar[int]
    STORE_BYTES_FIELD_NUMBER: _ClassVar[int]
    STATISTICS_JSON_FIELD_NUMBER: _ClassVar[int]
    session_id: str
    robot_id: str
    run_id: str
    site_id: str
    map_id: str
    finished: bool
    epoch: int
    durable_seq: int
    first_stamp_ns: int
    last_stamp_ns: int
    frames: int
    keyframes: int
    loops: int
    gnss_factors: int
    store_bytes: int
    statistics_json: str
    def __init__(self, session_id: _Optional[str] = ..., robot_id: _Optional[str] = ..., run_id: _Optional[str] = ..., site_id: _Optional[str] = ..., map_id: _Optional[str] = ..., finished: bool = ..., epoch: _Optional[int] = ..., durable_seq: _Optional[int] = ..., first_stamp_ns: _Optional[int] = ..., last_stamp_ns: _Optional[int] = ..., frames: _Optional[int] = ..., keyframes: _Optional[int] = ..., loops: _Optional[int] = ..., gnss_factors: _Optional[int] = ..., store_bytes: _Optional[int] = ..., statistics_json: _Optional[str] = ...) -> None: ...

class ListRequest(_message.Message):
    __slots__ = ("site_id",)
    SITE_ID_FIELD_NUMBER: _ClassVar[int]
    site_id: str
    def __init__(self, site_id: _Optional[str] = ...) -> None: ...

class ListResponse(_message.Message):
    __slots__ = ("sessions",)
    SESSIONS_FIELD_NUMBER: _ClassVar[int]
    sessions: _containers.RepeatedCompositeFieldContainer[SessionInfo]
    def __init__(self, sessions: _Optional[_Iterable[_Union[SessionInfo, _Mapping]]] = ...) -> None: ...

class GetRequest(_message.Message):
    __slots__ = ("session_id",)
    SESSION_ID_FIELD_NUMBER: _ClassVar[int]
    session_id: str
    def __init__(self, session_id: _Optional[str] = ...) -> None: ...

class GetResponse(_message.Message):
    __slots__ = ("session",)
    SESSION_FIELD_NUMBER: _ClassVar[int]
    session: SessionInfo
    def __init__(self, session: _Optional[_Union[SessionInfo, _Mapping]] = ...) -> None: ...

class DeleteRequest(_message.Message):
    __slots__ = ("session_id",)
    SESSION_ID_FIELD_NUMBER: _ClassVar[int]
    session_id: str
    def __init__(self, session_id: _Optional[str] = ...) -> None: ...

class DeleteResponse(_message.Message):
    __slots__ = ("frames", "keyframes", "bytes")
    FRAMES_FIELD_NUMBER: _ClassVar[int]
    KEYFRAMES_FIELD_NUMBER: _ClassVar[int]
    BYTES_FIELD_NUMBER: _ClassVar[int]
    frames: int
    keyframes: int
    bytes: int
    def __init__(self, frames: _Optional[int] = ..., keyframes: _Optional[int] = ..., bytes: _Optional[int] = ...) -> None: ...

class TrajectoryRequest(_message.Message):
    __slots__ = ("session_id",)
    SESSION_ID_FIELD_NUMBER: _ClassVar[int]
    session_id: str
    def __init__(self, session_id: _Optional[str] = ...) -> None: ...

class TrajectoryResponse(_message.Message):
    __slots__ = ("poses",)
    POSES_FIELD_NUMBER: _ClassVar[int]
    poses: _containers.RepeatedCompositeFieldContainer[_types_pb2.StampedPose]
    def __init__(self, poses: _Optional[_Iterable[_Union[_types_pb2.StampedPose, _Mapping]]] = ...) -> None: ...

class StreamMapRequest(_message.Message):
    __slots__ = ("session_id", "voxel_m", "first_keyframe", "dense")
    SESSION_ID_FIELD_NUMBER: _ClassVar[int]
    VOXEL_M_FIELD_NUMBER: _ClassVar[int]
    FIRST_KEYFRAME_FIELD_NUMBER: _ClassVar[int]
    DENSE_FIELD_NUMBER: _ClassVar[int]
    session_id: str
    voxel_m: float
    first_keyframe: int
    dense: bool
    def __init__(self, session_id: _Optional[str] = ..., voxel_m: _Optional[float] = ..., first_keyframe: _Optional[int] = ..., dense: bool = ...) -> None: ...

class StreamMapResponse(_message.Message):
    __slots__ = ("keyframe", "pose_map_lidar", "points", "point_count", "stamp_ns", "dense_cloud")
    KEYFRAME_FIELD_NUMBER: _ClassVar[int]
    POSE_MAP_LIDAR_FIELD_NUMBER: _ClassVar[int]
    POINTS_FIELD_NUMBER: _ClassVar[int]
    POINT_COUNT_FIELD_NUMBER: _ClassVar[int]
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    DENSE_CLOUD_FIELD_NUMBER: _ClassVar[int]
    keyframe: int
    pose_map_lidar: _types_pb2.Transform
    points: bytes
    point_count: int
    stamp_ns: int
    dense_cloud: bytes
    def __init__(self, keyframe: _Optional[int] = ..., pose_map_lidar: _Optional[_Union[_types_pb2.Transform, _Mapping]] = ..., points: _Optional[bytes] = ..., point_count: _Optional[int] = ..., stamp_ns: _Optional[int] = ..., dense_cloud: _Optional[bytes] = ...) -> None: ...

class PoseGraphRequest(_message.Message):
    __slots__ = ("session_id",)
    SESSION_ID_FIELD_NUMBER: _ClassVar[int]
    session_id: str
    def __init__(self, session_id: _Optional[str] = ...) -> None: ...

class GraphKeyframe(_message.Message):
    __slots__ = ("keyframe", "stamp_ns", "pose_map_lidar")
    KEYFRAME_FIELD_NUMBER: _ClassVar[int]
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    POSE_MAP_LIDAR_FIELD_NUMBER: _ClassVar[int]
    keyframe: int
    stamp_ns: int
    pose_map_lidar: _types_pb2.Transform
    def __init__(self, keyframe: _Optional[int] = ..., stamp_ns: _Optional[int] = ..., pose_map_lidar: _Optional[_Union[_types_pb2.Transform, _Mapping]] = ...) -> None: ...

class GraphEdge(_message.Message):
    __slots__ = ("kind", "older", "newer", "pose_older_newer", "covariance", "robust")
    KIND_FIELD_NUMBER: _ClassVar[int]
    OLDER_FIELD_NUMBER: _ClassVar[int]
    NEWER_FIELD_NUMBER: _ClassVar[int]
    POSE_OLDER_NEWER_FIELD_NUMBER: _ClassVar[int]
    COVARIANCE_FIELD_NUMBER: _ClassVar[int]
    ROBUST_FIELD_NUMBER: _ClassVar[int]
    kind: str
    older: int
    newer: int
    pose_older_newer: _types_pb2.Transform
    covariance: _containers.RepeatedScalarFieldContainer[float]
    robust: bool
    def __init__(self, kind: _Optional[str] = ..., older: _Optional[int] = ..., newer: _Optional[int] = ..., pose_older_newer: _Optional[_Union[_types_pb2.Transform, _Mapping]] = ..., covariance: _Optional[_Iterable[float]] = ..., robust: bool = ...) -> None: ...

class GraphFix(_message.Message):
    __slots__ = ("keyframe", "antenna_keyframe_m", "enu_m", "sigmas_m", "datum")
    KEYFRAME_FIELD_NUMBER: _ClassVar[int]
    ANTENNA_KEYFRAME_M_FIELD_NUMBER: _ClassVar[int]
    ENU_M_FIELD_NUMBER: _ClassVar[int]
    SIGMAS_M_FIELD_NUMBER: _ClassVar[int]
    DATUM_FIELD_NUMBER: _ClassVar[int]
    keyframe: int
    antenna_keyframe_m: _containers.RepeatedScalarFieldContainer[float]
    enu_m: _containers.RepeatedScalarFieldContainer[float]
    sigmas_m: _containers.RepeatedScalarFieldContainer[float]
    datum: int
    def __init__(self, keyframe: _Optional[int] = ..., antenna_keyframe_m: _Optional[_Iterable[float]] = ..., enu_m: _Optional[_Iterable[float]] = ..., sigmas_m: _Optional[_Iterable[float]] = ..., datum: _Optional[int] = ...) -> None: ...

class GraphDatum(_message.Message):
    __slots__ = ("datum", "pose_enu_map")
    DATUM_FIELD_NUMBER: _ClassVar[int]
    POSE_ENU_MAP_FIELD_NUMBER: _ClassVar[int]
    datum: int
    pose_enu_map: _types_pb2.Transform
    def __init__(self, datum: _Optional[int] = ..., pose_enu_map: _Optional[_Union[_types_pb2.Transform, _Mapping]] = ...) -> None: ...

class EnuOrigin(_message.Message):
    __slots__ = ("latitude_deg", "longitude_deg", "altitude_m")
    LATITUDE_DEG_FIELD_NUMBER: _ClassVar[int]
    LONGITUDE_DEG_FIELD_NUMBER: _ClassVar[int]
    ALTITUDE_M_FIELD_NUMBER: _ClassVar[int]
    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    def __init__(self, latitude_deg: _Optional[float] = ..., longitude_deg: _Optional[float] = ..., altitude_m: _Optional[float] = ...) -> None: ...

class PoseGraphResponse(_message.Message):
    __slots__ = ("keyframes", "edges", "fixes", "data", "origin", "others")
    class OthersEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: int
        def __init__(self, key: _Optional[str] = ..., value: _Optional[int] = ...) -> None: ...
    KEYFRAMES_FIELD_NUMBER: _ClassVar[int]
    EDGES_FIELD_NUMBER: _ClassVar[int]
    FIXES_FIELD_NUMBER: _ClassVar[int]
    DATA_FIELD_NUMBER: _ClassVar[int]
    ORIGIN_FIELD_NUMBER: _ClassVar[int]
    OTHERS_FIELD_NUMBER: _ClassVar[int]
    keyframes: _containers.RepeatedCompositeFieldContainer[GraphKeyframe]
    edges: _containers.RepeatedCompositeFieldContainer[GraphEdge]
    fixes: _containers.RepeatedCompositeFieldContainer[GraphFix]
    data: _containers.RepeatedCompositeFieldContainer[GraphDatum]
    origin: EnuOrigin
    others: _containers.ScalarMap[str, int]
    def __init__(self, keyframes: _Optional[_Iterable[_Union[GraphKeyframe, _Mapping]]] = ..., edges: _Optional[_Iterable[_Union[GraphEdge, _Mapping]]] = ..., fixes: _Optional[_Iterable[_Union[GraphFix, _Mapping]]] = ..., data: _Optional[_Iterable[_Union[GraphDatum, _Mapping]]] = ..., origin: _Optional[_Union[EnuOrigin, _Mapping]] = ..., others: _Optional[_Mapping[str, int]] = ...) -> None: ...
