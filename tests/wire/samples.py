"""One message of every kind with every field set, and its way through the wire.

Also run on its own by another interpreter environment, so it needs nothing but protobuf and grpc:
prints JSON {"protobuf": version, "messages": {name: [hex of each variant]}}.
"""

from __future__ import annotations

import importlib
import json
import sys
from collections.abc import Iterator

from google.protobuf import __version__ as protobuf_version
from google.protobuf.descriptor import Descriptor, FieldDescriptor
from google.protobuf.message import Message
from google.protobuf.message_factory import GetMessageClass

MODULES = ("types", "session", "local", "pose", "view", "dense")


def messages() -> Iterator[Message]:
    """Every message of the contract, filled; one with a `oneof` comes once for each of its variants."""
    for name in MODULES:
        module = importlib.import_module(f"splitslam.wire.{name}_pb2")
        for descriptor in module.DESCRIPTOR.message_types_by_name.values():
            yield from variants(descriptor)


def variants(descriptor: Descriptor) -> Iterator[Message]:
    choices = [field for oneof in descriptor.oneofs for field in oneof.fields]
    for choice in choices or [None]:
        message = GetMessageClass(descriptor)()
        for field in descriptor.fields:
            if field.containing_oneof is None or field is choice:
                _fill(message, field)
        yield message


def _is_repeated(field: FieldDescriptor) -> bool:
    # protobuf 5 has `label` only, protobuf 7 has dropped it.
    known = getattr(field, "is_repeated", None)
    return bool(known) if known is not None else getattr(field, "label") == FieldDescriptor.LABEL_REPEATED  # noqa: B009


def _fill(message: Message, field: FieldDescriptor) -> None:
    kind = field.message_type
    if kind is not None and kind.GetOptions().map_entry:
        key, value = kind.fields_by_name["key"], kind.fields_by_name["value"]
        getattr(message, field.name)[_scalar(key)] = _scalar(value)
    elif kind is not None and _is_repeated(field):
        getattr(message, field.name).extend([*variants(kind), *variants(kind)])
    elif kind is not None:
        getattr(message, field.name).CopyFrom(next(variants(kind)))
    elif _is_repeated(field):
        getattr(message, field.name).extend([_scalar(field), _scalar(field)])
    else:
        setattr(message, field.name, _scalar(field))


def _scalar(field: FieldDescriptor) -> str | bytes | bool | int | float:
    """Not the default, different for each field, exact in float32, and beyond 32 bits where 64 are promised."""
    if field.enum_type is not None:
        return field.enum_type.values[-1].number
    match field.cpp_type:
        case FieldDescriptor.CPPTYPE_STRING if field.type == FieldDescriptor.TYPE_BYTES:
            return bytes([0, 255, field.number])
        case FieldDescriptor.CPPTYPE_STRING:
            return f"{field.name} \N{GREEK SMALL LETTER MU}"
        case FieldDescriptor.CPPTYPE_BOOL:
            return True
        case FieldDescriptor.CPPTYPE_DOUBLE | FieldDescriptor.CPPTYPE_FLOAT:
            return field.number + 0.25
        case FieldDescriptor.CPPTYPE_UINT64:
            return 2**64 - field.number
        case FieldDescriptor.CPPTYPE_INT64:
            return -(2**63) + field.number
        case FieldDescriptor.CPPTYPE_UINT32:
            return 2**32 - field.number
        case _:
            return -(2**31) + field.number


def main() -> None:
    for name in MODULES:
        importlib.import_module(f"splitslam.wire.{name}_pb2_grpc")
    out: dict[str, list[str]] = {}
    for message in messages():
        wire = message.SerializeToString(deterministic=True)
        if type(message).FromString(wire) != message:
            sys.exit(f"{message.DESCRIPTOR.full_name} does not come back as it went")
        out.setdefault(message.DESCRIPTOR.full_name, []).append(wire.hex())
    print(json.dumps({"protobuf": protobuf_version, "messages": out}))


if __name__ == "__main__":
    main()
