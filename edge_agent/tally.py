"""What one run adds up to: the numbers of edge.json that /metrics does not keep."""

from __future__ import annotations

import hashlib
import time
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

from edge_agent.metrics import EdgeMetrics
from edge_agent.odometry.outage import LOST
from edge_agent.rate import RateControl
from edge_agent.sources import Counts
from edge_agent.tcp_meter import TcpBytes
from edge_agent.types import EncodedFrame
from edge_agent.wire import Answer

# The paper's Case 1: what the same sensors send without an edge.
RAW_POINT_BYTES, RAW_IMU_BYTES = 18, 320
_NONE = TcpBytes()


@dataclass(slots=True)
class Tally:
    """Counts of the scans that went through, and the clocks around them. keep: series by scan as well.

    first_seq: this agent's first frame; replayed: frames of an agent before that were answered now.
    """

    keep: bool = True
    first_seq: int = 1
    sent: int = 0
    payload_bytes: int = 0
    mapped: int = 0
    lost: int = 0  # of them, answered in the state lost: the pose is a guess
    rejected: int = 0
    replayed: int = 0
    corrections_by_cause: Counter[str] = field(default_factory=Counter)
    correction_max_m: float = 0.0
    stamps_ns: list[int] = field(default_factory=list)
    frame_bytes: list[int] = field(default_factory=list)
    dense: list[bool] = field(default_factory=list)
    round_trips_ms: dict[int, float] = field(default_factory=dict)  # by seq
    _sha256: Any = field(default_factory=hashlib.sha256)
    _begin: tuple[float, float, float] | None = None
    _end: tuple[float, float, float] | None = None

    def begin(self, reader_cpu_s: float) -> None:
        """The first scan goes into the pipeline now."""
        if self._begin is None:
            self._begin = _clocks(reader_cpu_s)

    def end(self, reader_cpu_s: float) -> None:
        """The last answer is here."""
        self._end = _clocks(reader_cpu_s)

    def frame(self, frame: EncodedFrame) -> None:
        self.sent += 1
        self.payload_bytes += len(frame.payload)
        self._sha256.update(frame.payload)
        if self.keep:
            self.stamps_ns.append(frame.stamp_ns)
            self.frame_bytes.append(len(frame.payload))
            self.dense.append(frame.dense)

    def answer(self, answer: Answer) -> None:
        if self.keep:
            self.round_trips_ms[answer.reply.seq] = answer.round_trip_s * 1e3
        if answer.reply.rejected:
            self.rejected += 1
            return
        if answer.reply.seq < self.first_seq:
            self.replayed += 1
            return
        self.mapped += 1
        self.lost += answer.reply.state == LOST
        if answer.correction_m is not None:
            self.correction(answer.correction_cause, answer.correction_m)

    @property
    def corrections(self) -> int:
        return self.corrections_by_cause.total()

    def correction(self, cause: str, size_m: float) -> None:
        """T_map_odom has jumped, for a stated cause."""
        self.corrections_by_cause[cause] += 1
        self.correction_max_m = max(self.correction_max_m, size_m)

    def times(self) -> dict[str, Any]:
        """wall_s and cpu_ms_per_scan: first scan handed over to last answer, start-up excluded."""
        if self._begin is None or self._end is None:
            return {"wall_s": None, "cpu_ms_per_scan": {"edge": None, "reader": None}}
        wall_s, process_s, reader_s = (b - a for a, b in zip(self._begin, self._end, strict=True))
        scans = max(1, self.sent)
        edge_ms, reader_ms = (process_s - reader_s) * 1e3 / scans, reader_s * 1e3 / scans
        return {"wall_s": wall_s, "cpu_ms_per_scan": {"edge": edge_ms, "reader": reader_ms}}

    def link(
        self, live: TcpBytes, recording_s: float, counts: Counts, rate: RateControl, dense: TcpBytes = _NONE
    ) -> dict[str, Any]:
        """The keys `uplink` and `downlink` of report.json. Rates go by recording time; null without any.

        live, dense: of the frames' connections, and of those of whole scans.
        """
        tcp = live + dense
        raw_bytes = RAW_POINT_BYTES * counts.read_points + RAW_IMU_BYTES * counts.imu_messages

        def kbps(size: int) -> float | None:
            return size * 8 / recording_s / 1000 if recording_s > 0 else None

        return {
            "uplink": {
                "bytes": tcp.sent,
                "payload_bytes": self.payload_bytes,
                "payload_sha256": self._sha256.hexdigest(),
                "kbps": kbps(tcp.sent),
                "live_bytes": live.sent,
                "live_kbps": kbps(live.sent),
                "dense_bytes": dense.sent,
                "bytes_per_scan": tcp.sent / self.sent if self.sent else None,
                "raw_kbps": kbps(raw_bytes),
                "native_kbps": kbps(counts.native_bytes) if counts.native_bytes else None,
                "ratio_to_raw": raw_bytes / tcp.sent if tcp.sent else None,
                "limit_kbps": rate.limit_kbps,
                "withheld_points": rate.withheld_points,
            },
            "downlink": {"bytes": tcp.received, "kbps": kbps(tcp.received)},
        }

    def by_scan(self) -> dict[str, list[Any]]:
        """Series for plots, one entry a frame; null where no answer came."""
        return {
            "stamps_ns_by_scan": self.stamps_ns,
            "bytes_by_scan": self.frame_bytes,
            "dense_by_scan": self.dense,
            "round_trip_ms_by_scan": [self.round_trips_ms.get(self.first_seq + i) for i in range(len(self.stamps_ns))],
        }


def stage_summaries(metrics: EdgeMetrics) -> dict[str, Any]:
    """edge_ms, edge_wall_ms and round_trip_ms from the very observations /metrics has."""
    return {
        "edge_ms": {stage: series.summary_ms() for stage, series in metrics.stage_cpu.items()},
        "edge_wall_ms": {stage: series.summary_ms() for stage, series in metrics.stage_wall.items()},
        "round_trip_ms": metrics.round_trip.summary_ms(),
    }


def _clocks(reader_cpu_s: float) -> tuple[float, float, float]:
    return time.monotonic(), time.process_time(), reader_cpu_s
