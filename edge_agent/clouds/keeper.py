"""From frames to clouds on disk, on a thread of its own: no frame waits for an encoder, or until a cloud is written."""

from __future__ import annotations

import logging
import queue
import threading
from dataclasses import dataclass

from edge_agent.clouds.shelf import CloudShelf
from splitslam import dense_cloud
from splitslam.dense_cloud import WholeScan
from splitslam.errors import DataError
from splitslam.logs import fields

_SCANS = 4  # that wait; half a megabyte each for 16 rings
_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class _Answer:
    """What the service says of a frame."""

    seq: int
    is_key: bool


@dataclass(frozen=True, slots=True)
class _Lost:
    """There is no cloud of a frame, and why: a loss if it becomes a keyframe."""

    seq: int
    reason: str


class CloudKeeper:
    """Takes the whole scans of dense frames, and the service's word which of them are keyframes."""

    def __init__(self, shelf: CloudShelf, step_m: float, lockstep: bool) -> None:
        """lockstep: frames wait when scans come too fast; else such a scan is lost (`busy`)."""
        self._shelf, self._step_m, self._lockstep = shelf, step_m, lockstep
        self._jobs: queue.SimpleQueue[WholeScan | _Answer | _Lost | threading.Event | None] = queue.SimpleQueue()
        self._room = threading.Semaphore(_SCANS)
        self._lost: dict[int, str] = {}
        self._thread = threading.Thread(target=self._run, name="dense-clouds", daemon=True)
        self._thread.start()

    def keep(self, scan: WholeScan) -> None:
        """Of a frame that may become a keyframe."""
        self._shelf.take(scan.seq, scan.stamp_ns)
        if self._room.acquire(blocking=self._lockstep):
            self._jobs.put(scan)
        else:
            self._jobs.put(_Lost(scan.seq, "busy"))

    def lose(self, seq: int, stamp_ns: int, reason: str) -> None:
        """There is no cloud of a frame that may become a keyframe."""
        self._shelf.take(seq, stamp_ns)
        self._jobs.put(_Lost(seq, reason))

    def answered(self, seq: int, is_key: bool) -> None:
        """The service has answered a frame."""
        self._jobs.put(_Answer(seq, is_key))

    def flush(self) -> None:
        """Waits until all that was taken is on disk."""
        done = threading.Event()
        self._jobs.put(done)
        done.wait()

    def close(self) -> None:
        """The same, and the thread ends."""
        self._jobs.put(None)
        self._thread.join()

    def _run(self) -> None:
        while (job := self._jobs.get()) is not None:
            match job:
                case WholeScan():
                    self._keep(job)
                    self._room.release()
                case _Answer(seq, is_key):
                    self._take(seq, is_key)
                case _Lost(seq, reason):
                    self._lost[seq] = reason
                case threading.Event():
                    job.set()

    def _keep(self, scan: WholeScan) -> None:
        try:
            self._shelf.put(scan.seq, dense_cloud.encode(scan, self._step_m))
        except (DataError, ValueError) as error:
            _log.warning("dense cloud not encoded", extra=fields(seq=scan.seq, detail=str(error)))
            self._lost[scan.seq] = "encode"
        except Exception:  # a defect here must cost clouds, not frames
            _log.exception("dense cloud not kept", extra=fields(seq=scan.seq))
            self._lost[scan.seq] = "encode"

    def _take(self, seq: int, is_key: bool) -> None:
        reason = self._lost.pop(seq, None)
        if reason is None:
            self._shelf.answered(seq, is_key)
        else:
            self._shelf.answered_without(seq, is_key, reason)
