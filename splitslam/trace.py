"""The name of a frame in the log lines of both sides."""

from __future__ import annotations


def trace_id(run_id: str, seq: int) -> str:
    """16 hex digits: the first 8 of the run's UUID, then seq. Both sides can tell, so it need not travel."""
    return f"{run_id[:8]}{seq & 0xFFFFFFFF:08x}"
