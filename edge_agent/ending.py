"""Why a stream is over."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Ending:
    """cause: a word to count by, of edge_agent.metric_list.BREAKS. text: a line to read."""

    cause: str
    text: str

    def __str__(self) -> str:
        return self.text
