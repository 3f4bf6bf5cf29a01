"""Names of protobuf's enum values. Enums are open: a later program sends numbers that have no name here."""

from __future__ import annotations

from typing import Any


def value_name(enum: Any, value: int, prefix: str = "") -> str:
    """In lower case and without its prefix; the number itself where it has none.

    enum: a generated one, such as types_pb2.TrackingState.
    """
    known = enum.DESCRIPTOR.values_by_number.get(value)
    return str(value) if known is None else known.name.removeprefix(prefix).lower()
