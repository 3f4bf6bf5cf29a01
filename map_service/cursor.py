"""What somebody who follows sessions has of them, as a text that he gives back when he calls again."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass

_MOST_SESSIONS = 10_000  # ten times what a call follows; a database takes 32,766 names in a question


class CursorError(ValueError):
    """Not a cursor."""


@dataclass(frozen=True, slots=True)
class Cursor:
    """Everything of sessions opened up to that of key `newest_key` is known, but for what is in `numbers`.

    numbers: by session id of those that have not ended, the newest event, or scan, that is known.
    """

    newest_key: int
    numbers: Mapping[str, int]

    def text(self) -> str:
        return json.dumps([self.newest_key, dict(self.numbers)], separators=(",", ":"))

    @classmethod
    def parse(cls, text: str) -> Cursor | None:
        """The reverse; None for no text. Raises CursorError."""
        if not text:
            return None
        try:
            newest, numbers = json.loads(text)
            if len(numbers) > _MOST_SESSIONS:
                raise ValueError
            return cls(_number(newest), {str(name): _number(number) for name, number in numbers.items()})
        except (ValueError, TypeError, AttributeError, RecursionError):
            raise CursorError(f"cursor {text[:80]!r}: expected one of an earlier message") from None


def _number(value: object) -> int:
    if not isinstance(value, int) or not 0 <= value < 2**63:
        raise ValueError
    return value
