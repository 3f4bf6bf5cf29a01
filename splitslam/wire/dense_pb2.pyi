from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from typing import ClassVar as _ClassVar, Mapping as _Mapping, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class CloudVerdict(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
    __slots__ = ()
    CLOUD_VERDICT_UNSPECIFIED: _ClassVar[CloudVerdict]
    CLOUD_VERDICT_WANTED: _ClassVar[CloudVerdict]
    CLOUD_VERDICT_STORED: _ClassVar[CloudVerdict]
    CLOUD_VERDICT_NOT_A_KEYFRAME: _ClassVar[CloudVerdict]
    CLOUD_VERDICT_NOT_YET: _ClassVar[CloudVerdict]
    CLOUD_VERDICT_REFUSED: _ClassVar[CloudVerdict]
    CLOUD_VERDICT_NO_ROOM: _ClassVar[CloudVerdict]
    CLOUD_VERDICT_NO_SESSION: _ClassVar[CloudVerdict]
CLOUD_VERDICT_UNSPECIFIED: CloudVerdict
CLOUD_VERDICT_WANTED: CloudVerdict
CLOUD_VERDICT_STORED: CloudVerdict
CLOUD_VERDICT_NOT_A_KEYFRAME: CloudVerdict
CLOUD_VERDICT_NOT_YET: CloudVerdict
CLOUD_VERDICT_REFUSED: CloudVerdict
CLOUD_VERDICT_NO_ROOM: CloudVerdict
CLOUD_VERDICT_NO_SESSION: CloudVerdict

class UploadOpen(_message.Message):
    __slots__ = ("robot_id", "run_id", "site_id")
    ROBOT_ID_FIELD_NUMBER: _ClassVar[int]
    RUN_ID_FIELD_NUMBER: _ClassVar[int]
    SITE_ID_FIELD_NUMBER: _ClassVar[int]
    robot_id: str
    run_id: str
    site_id: str
    def __init__(self, robot_id: _Optional[str] = ..., run_id: _Optional[str] = ..., site_id: _Optional[str] = ...) -> None: ...

class CloudOffer(_message.Message):
    __slots__ = ("seq", "stamp_ns", "size")
    SEQ_FIELD_NUMBER: _ClassVar[int]
    STAMP_NS_FIELD_NUMBER: _ClassVar[int]
    SIZE_FIELD_NUMBER: _ClassVar[int]
    seq: int
    stamp_ns: int
    size: int
    def __init__(self, seq: _Optional[int] = ..., stamp_ns: _Optional[int] = ..., size: _Optional[int] = ...) -> None: ...

class CloudChunk(_message.Message):
    __slots__ = ("offset", "data")
    OFFSET_FIELD_NUMBER: _ClassVar[int]
    DATA_FIELD_NUMBER: _ClassVar[int]
    offset: int
    data: bytes
    def __init__(self, offset: _Optional[int] = ..., data: _Optional[bytes] = ...) -> None: ...

class UploadRequest(_message.Message):
    __slots__ = ("open", "offer", "chunk")
    OPEN_FIELD_NUMBER: _ClassVar[int]
    OFFER_FIELD_NUMBER: _ClassVar[int]
    CHUNK_FIELD_NUMBER: _ClassVar[int]
    open: UploadOpen
    offer: CloudOffer
    chunk: CloudChunk
    def __init__(self, open: _Optional[_Union[UploadOpen, _Mapping]] = ..., offer: _Optional[_Union[CloudOffer, _Mapping]] = ..., chunk: _Optional[_Union[CloudChunk, _Mapping]] = ...) -> None: ...

class UploadResponse(_message.Message):
    __slots__ = ("verdict", "received_bytes", "detail", "retry_after_ms")
    VERDICT_FIELD_NUMBER: _ClassVar[int]
    RECEIVED_BYTES_FIELD_NUMBER: _ClassVar[int]
    DETAIL_FIELD_NUMBER: _ClassVar[int]
    RETRY_AFTER_MS_FIELD_NUMBER: _ClassVar[int]
    verdict: CloudVerdict
    received_bytes: int
    detail: str
    retry_after_ms: int
    def __init__(self, verdict: _Optional[_Union[CloudVerdict, str]] = ..., received_bytes: _Optional[int] = ..., detail: _Optional[str] = ..., retry_after_ms: _Optional[int] = ...) -> None: ...
