"""The two families of errors: bad input ends a command, bad data drops one scan.

A programmer's error is neither: it raises whatever Python raises and is not caught.
"""

from __future__ import annotations


class InputError(Exception):
    """A file, option or key that cannot be used; the command ends with exit code 2.

    The text is one line that says what, where and what was expected.
    """

    exit_code = 2


class DataError(Exception):
    """One scan, frame or message of a running stream that cannot be used.

    It is dropped and counted under `reason` (a short label: `nan`, `empty`, `corrupt`, ...).
    """

    def __init__(self, reason: str, detail: str = "") -> None:
        super().__init__(f"{reason}: {detail}" if detail else reason)
        self.reason = reason
        self.detail = detail
