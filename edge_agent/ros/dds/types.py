"""ROS 2's message types for CycloneDDS, made from the definitions that `rosbags` has.

DDS must know a type to match it with that of ROS nodes, and checks what comes in by it. Converting a message is left to
`rosbags`, which reads the bytes of a cloud as an array, where CycloneDDS's Python layer makes a list of numbers.
"""

from __future__ import annotations

from typing import Any

from cyclonedds.idl import make_idl_struct, types
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

_BASE: dict[str, Any] = {
    "bool": bool,
    "byte": types.uint8,
    "char": types.uint8,
    "string": str,
    **{name: getattr(types, name) for name in ("int8", "int16", "int32", "int64", "float32", "float64")},
    **{name: getattr(types, name) for name in ("uint8", "uint16", "uint32", "uint64")},
}


class RawSample:
    """What stands in for a message's object: its CDR bytes, encapsulation header included."""

    def __init__(self, raw: bytes) -> None:
        self.raw = raw
        self.sample_info: Any = None

    def serialize(self, *_: Any, **__: Any) -> bytes:
        """What a writer sends."""
        return self.raw

    @classmethod
    def deserialize(cls, data: bytes, *_: Any, **__: Any) -> RawSample:
        """What a reader hands on."""
        return cls(data)


def raw_type(name: str, store: Typestore) -> Any:
    """The DDS type of `sensor_msgs/msg/Imu`; its samples are RawSamples by another name."""
    kind = _struct(name, store, {})
    for method in ("__init__", "serialize", "deserialize"):  # not inherited: to DDS a base is a part of the type
        setattr(kind, method, vars(RawSample)[method])
    kind.deserialize_key = kind.deserialize
    return kind


def dds_type_name(name: str) -> str:
    """`sensor_msgs/msg/Imu` -> `sensor_msgs::msg::dds_::Imu_`."""
    package, kind, bare = name.split("/")
    return f"{package}::{kind}::dds_::{bare}_"


def ros_type_name(name: str) -> str | None:
    """The reverse; None for a type that is not one of ROS 2's messages."""
    parts = name.split("::")
    if len(parts) != 4 or parts[1:3] != ["msg", "dds_"] or not parts[3].endswith("_"):
        return None
    return f"{parts[0]}/msg/{parts[3][:-1]}"


def _struct(name: str, store: Typestore, made: dict[str, Any]) -> Any:
    """made: the types inside, each once."""
    fields = {field: _field(kind, store, made) for field, kind in store.fielddefs[name][1]}
    dotted = dds_type_name(name).replace("::", ".")
    return make_idl_struct(f"{name.rsplit('/', 1)[-1]}_", dotted, fields, dataclassify=False)


def _field(kind: Any, store: Typestore, made: dict[str, Any]) -> Any:
    node, of = kind
    if node is Nodetype.BASE:
        return _BASE[of[0]]
    if node is Nodetype.NAME:
        if of not in made:
            made[of] = _struct(of, store, made)
        return made[of]
    inner, length = of
    element = _field(inner, store, made)
    if node is Nodetype.ARRAY:
        return types.array[element, length]
    return types.sequence[element, length] if length else types.sequence[element]
