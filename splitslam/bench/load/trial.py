"""One try: a fresh service with an empty store, N robots for some seconds, and what came of it."""

from __future__ import annotations

import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from splitslam.bench.load.costs import Usage, usage
from splitslam.bench.load.fleet import Fleet, Played
from splitslam.stack.process import StackError
from splitslam.stack.reel import Reel
from splitslam.stack.replica import Replica

P99_MS = 100.0
Start = Literal["together", "spread"]
_DAY_S = 86_400.0
_PHASES_S = 1.0  # robots that are spread begin within this time: out of step in their scans and in their keyframes


@dataclass(frozen=True, slots=True)
class Percentiles:
    """ms."""

    p50: float
    p99: float
    max: float

    @classmethod
    def of(cls, values_ms: np.ndarray) -> Percentiles:
        """NaN of nothing."""
        if not len(values_ms):
            return cls(*[float("nan")] * 3)
        return cls(*(round(float(np.percentile(values_ms, share)), 2) for share in (50, 99, 100)))


@dataclass(frozen=True, slots=True)
class RobotCost:
    """What each robot took of the service: cores (the generator's own are beside), memory beyond that of a service
    without robots, store written, TCP payload both ways.
    """

    cores: float
    generator_cores: float
    memory_mb: float
    store_gb_a_day: float
    uplink_kbps: float
    downlink_kbps: float


@dataclass(frozen=True, slots=True)
class Trial:
    """frames: sent by all robots. answer_ms: from when a frame was due. late_ms: how late the generator sent it."""

    robots: int
    start: Start
    seconds: float
    frames: int
    unanswered: int
    answer_ms: Percentiles
    late_ms: Percentiles
    cost: RobotCost
    idle_mb: float  # the service without robots
    wrong: list[str]

    @property
    def passed(self) -> bool:
        """In time, nothing dropped, every answer as it must be."""
        return not self.wrong and not self.unanswered and self.answer_ms.p99 < P99_MS

    def as_dict(self) -> dict[str, Any]:
        """JSON-ready."""
        return {**asdict(self), "passed": self.passed}


class Bench:
    """Tries on one reel; each with a service of its own, so that what one leaves behind does not slow the next."""

    def __init__(self, reel: Reel, workers: int, rate_hz: float = 10.0) -> None:
        """workers: of the service, 0: as many as it takes by itself."""
        self._reel, self._workers, self._rate_hz = reel, workers, rate_hz

    def try_out(self, robots: int, seconds: float, start: Start) -> Trial:
        """Raises StackError when the service does not come up."""
        with tempfile.TemporaryDirectory(prefix="splitslam-load-") as name:
            folder = Path(name)
            store = folder / "map.db"
            # by number of robots nobody is refused here: how many it can serve is what is asked
            settings = {"workers": self._workers, "limits": {"max_sessions": robots + 1}}
            service = Replica("map_service", folder, f"sqlite:///{store}", settings)
            try:
                service.start()
                fleet = Fleet(service.address, self._reel, self._offsets_s(robots, start), self._rate_hz)
                idle, looks = usage(service.pid), []
                played = fleet.play(seconds, lambda: looks.append(usage(service.pid)))
                service.check_alive()
                service.drain()  # what is in the journal is now in the store's file
            except StackError:
                service.kill()
                raise
            finally:
                service.kill()
            return self._trial(robots, start, played, idle, looks, store.stat().st_size)

    def _offsets_s(self, robots: int, start: Start) -> list[float]:
        return [_PHASES_S * i / robots if start == "spread" else 0.0 for i in range(robots)]

    def _trial(
        self, robots: int, start: Start, played: Played, idle: Usage, looks: list[Usage], store_bytes: int
    ) -> Trial:
        accounts, seconds = played.accounts, played.seconds
        used = looks[1] - looks[0]
        cost = RobotCost(
            cores=round(used.cpu_s / seconds / robots, 4),
            generator_cores=round(played.cpu_s / seconds / robots, 4),
            memory_mb=round((looks[1].pss_bytes - idle.pss_bytes) / robots / 1e6, 1),
            store_gb_a_day=round(store_bytes / seconds / robots * _DAY_S / 1e9, 3),
            uplink_kbps=round(played.tcp.sent * 8e-3 / seconds / robots, 1),
            downlink_kbps=round(played.tcp.received * 8e-3 / seconds / robots, 1),
        )
        return Trial(
            robots=robots,
            start=start,
            seconds=round(seconds, 1),
            frames=sum(len(account.sent_s) for account in accounts),
            unanswered=sum(account.unanswered for account in accounts),
            answer_ms=Percentiles.of(np.concatenate([account.answer_ms() for account in accounts])),
            late_ms=Percentiles.of(np.concatenate([account.late_ms() for account in accounts])),
            cost=cost,
            idle_mb=round(idle.pss_bytes / 1e6, 1),
            wrong=[line for account in accounts for line in account.wrong],
        )


def largest(passes, first: int, at_most: int) -> int:
    """The largest number for which passes(n) holds, 0 for none, if it holds for all below: doubled, then halved."""
    low, high, n = 0, at_most + 1, min(first, at_most)
    while high - low > 1:
        low, high = (n, high) if passes(n) else (low, n)
        n = min(2 * low, at_most) if low and high > at_most else (low + high) // 2
    return low
