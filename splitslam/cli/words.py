"""What several commands make of their arguments."""

from __future__ import annotations


def listed(text: str) -> tuple[str, ...]:
    """The parts of a comma-separated list, without what is empty."""
    return tuple(part.strip() for part in text.split(",") if part.strip())
