"""Where bytes come in. None of the ports waits: who reads them polls `fileno`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Protocol


class Port(Protocol):
    """One place where bytes come in. fileno: None while it is not open: `tend` opens it again when it is time.

    counts: of what became of the bytes, see metric `splitslam_edge_sensor_packets_total`.
    """

    counts: Counter[str]

    @property
    def fileno(self) -> int | None: ...
    @property
    def writes(self) -> bool:
        """It is ready when it can be written to: a connection that is being made."""
        ...

    def read(self) -> Iterator[tuple[bytes, int]]:
        """(bytes, arrival ns) of all that has come, a packet or what a stream had."""
        ...

    def tend(self) -> None: ...
    def close(self) -> None: ...
