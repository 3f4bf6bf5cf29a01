from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from typing import ClassVar as _ClassVar, Iterable as _Iterable, Mapping as _Mapping, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class TrackingState(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    TRACKING_STATE_UNSPECIFIED: _ClassVar[TrackingState]
    TRACKING_STATE_INITIALISING: _ClassVar[TrackingState]
    TRACKING_STATE_TRACKING: _ClassVar[TrackingState]
    TRACKING_STATE_DEGENERATE: _ClassVar[TrackingState]
    TRACKING_STATE_UNANCHORED: _ClassVar[TrackingState]
    TRACKING_STATE_LOCALISING: _ClassVar[TrackingState]
    TRACKING_STATE_LOST: _ClassVar[TrackingState]

class CorrectionCause(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    CORRECTION_CAUSE_UNSPECIFIED: _ClassVar[CorrectionCause]
    CORRECTION_CAUSE_LOOP: _ClassVar[CorrectionCause]
    CORRECTION_CAUSE_GNSS: _ClassVar[CorrectionCause]
    CORRECTION_CAUSE_RELOCALISE: _ClassVar[CorrectionCause]
    CORRECTION_CAUSE_REGISTRATION: _ClassVar[CorrectionCause]
TRACKING_STATE_UNSPECIFIED: TrackingState
TRACKING_STATE_INITIALISING: TrackingState
TRACKING_STATE_TRACKING: TrackingState
TRACKING_STATE_DEGENERATE: TrackingState
TRACKING_STATE_UNANCHORED: TrackingState
TRACKING_STATE_LOCALISING: TrackingState
TRACKING_STATE_LOST: TrackingState
CORRECTION_CAUSE_UNSPECIFIED: CorrectionCause
CORRECTION_CAUSE_LOOP: CorrectionCause
CORRECTION_CAUSE_GNSS: CorrectionCause
CORRECTION_CAUSE_RELOCALISE: CorrectionCause
CORRECTION_CAUSE_REGISTRATION: CorrectionCause

class Transform(_message.Message):
    __slots__ = ("tx_m", "ty_m", "tz_m", "qx", "qy", "qz", "qw")
    TX_M_FIELD_NUMBER: _ClassVar[int]
    TY_M_FIELD_NUMBER: _ClassVar[int]
    TZ_M_FIELD_NUMBER: _ClassVar[int]
    QX_FIELD_NUMBER: _ClassVar[int]
    QY_FIELD_NUMBER: _ClassVar[int]
    QZ_FIELD_NUMBER: _ClassVar[int]
    QW_FIELD_NUMBER: _ClassVar[int]
    tx_m: float
    ty_m: float
    tz_m: float
    qx: float
    qy: float
    qz: float
    qw: float
    def __init__(self, tx_m: _Optional[float] = ..., ty_m: _Optional[float] = ..., tz_m: _Optional[float] = ..., qx: _Optional[float] = ..., qy: _Optional[float] = ..., qz: _Optional[float] = ..., qw: _Optional[float] = ...) -> None: ...

class StampedPose(_message.Message):
    __slots__ = ("seq", "stamp_ns", "pose")
    SEQ_FIELD_NUMBER: _ClassVar[int]
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    POSE_FIELD_NUMBER: _ClassVar[int]
    seq: int
    stamp_ns: int
    pose: Transform
    def __init__(self, seq: _Optional[int] = ..., stamp_ns: _Optional[int] = ..., pose: _Optional[_Union[Transform, _Mapping]] = ...) -> None: ...

class GnssFix(_message.Message):
    __slots__ = ("stamp_ns", "latitude_deg", "longitude_deg", "altitude_m", "covariance_enu_m2", "status")
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    LATITUDE_DEG_FIELD_NUMBER: _ClassVar[int]
    LONGITUDE_DEG_FIELD_NUMBER: _ClassVar[int]
    ALTITUDE_M_FIELD_NUMBER: _ClassVar[int]
    COVARIANCE_ENU_M2_FIELD_NUMBER: _ClassVar[int]
    STATUS_FIELD_NUMBER: _ClassVar[int]
    stamp_ns: int
    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    covariance_enu_m2: _containers.RepeatedScalarFieldContainer[float]
    status: int
    def __init__(self, stamp_ns: _Optional[int] = ..., latitude_deg: _Optional[float] = ..., longitude_deg: _Optional[float] = ..., altitude_m: _Optional[float] = ..., covariance_enu_m2: _Optional[_Iterable[float]] = ..., status: _Optional[int] = ...) -> None: ...

class WheelMotion(_message.Message):
    __slots__ = ("motion_prev_body", "covariance")
    MOTION_PREV_BODY_FIELD_NUMBER: _ClassVar[int]
    COVARIANCE_FIELD_NUMBER: _ClassVar[int]
    motion_prev_body: Transform
    covariance: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, motion_prev_body: _Optional[_Union[Transform, _Mapping]] = ..., covariance: _Optional[_Iterable[float]] = ...) -> None: ...

class Correction(_message.Message):
    __slots__ = ("cause", "translation_m", "rotation_rad")
    CAUSE_FIELD_NUMBER: _ClassVar[int]
    TRANSLATION_M_FIELD_NUMBER: _ClassVar[int]
    ROTATION_RAD_FIELD_NUMBER: _ClassVar[int]
    cause: CorrectionCause
    translation_m: float
    rotation_rad: float
    def __init__(self, cause: _Optional[_Union[CorrectionCause, str]] = ..., translation_m: _Optional[float] = ..., rotation_rad: _Optional[float] = ...) -> None: ...
