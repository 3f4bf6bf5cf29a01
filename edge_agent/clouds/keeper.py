"""From frames to clouds on disk: whole scans are encoded on a thread of their own, which no frame waits for."""

from __future__ import annotations

import logging
import queue
import threading

from edge_agent.clouds.shelf import CloudShelf
from splitslam import dense_cloud
from splitslam.dense_cloud import WholeScan
from splitslam.errors import DataError
from splitslam.logs import fields

_QUEUE_SCANS = 4  # half a megabyte each for 16 rings
_log = logging.getLogger(__name__)


class CloudKeeper:
    """Takes the whole scans of dense frames, and the service's word which of them are keyframes."""

    def __init__(self, shelf: CloudShelf, step_m: float, lockstep: bool) -> None:
        """lockstep: frames wait for a full queue; else a scan that finds no room is lost (`busy`)."""
        self._shelf, self._step_m, self._lockstep = shelf, step_m, lockstep
        self._scans: queue.Queue[WholeScan | None] = queue.Queue(_QUEUE_SCANS)
        self._lock = threading.Lock()
        self._pending: dict[int, bool | None] = {}  # scans that are not on disk yet: keyframe or not, None: not known
        self._lost: dict[int, str] = {}  # why a scan has no cloud: a loss only if it becomes a keyframe
        self._thread = threading.Thread(target=self._run, name="dense-clouds", daemon=True)
        self._thread.start()

    def keep(self, scan: WholeScan) -> None:
        """Of a frame that may become a keyframe."""
        with self._lock:
            self._pending[scan.seq] = None
        try:
            self._scans.put(scan, block=self._lockstep)
        except queue.Full:
            self.lose(scan.seq, "busy")

    def lose(self, seq: int, reason: str) -> None:
        """There is no cloud of a frame that may become a keyframe."""
        with self._lock:
            if self._pending.pop(seq, None):
                self._shelf.lose(reason)
            else:
                self._lost[seq] = reason

    def answered(self, seq: int, is_key: bool) -> None:
        """The service has answered a frame."""
        with self._lock:
            if seq in self._pending:
                self._pending[seq] = is_key
                return
            reason = self._lost.pop(seq, None)
        if reason is not None:
            if is_key:
                self._shelf.lose(reason)
            return
        self._shelf.answered(seq, is_key)

    def close(self) -> None:
        """All that was taken is on disk."""
        self._scans.put(None)
        self._thread.join()

    def flush(self) -> None:
        """Waits until all that was taken is on disk."""
        self._scans.join()

    def _run(self) -> None:
        while (scan := self._scans.get()) is not None:
            try:
                self._keep(scan)
            except (DataError, ValueError) as error:
                _log.warning("dense cloud not encoded", extra=fields(seq=scan.seq, detail=str(error)))
                self.lose(scan.seq, "encode")
            except Exception:  # a defect here must cost clouds, not frames
                _log.exception("dense cloud not kept", extra=fields(seq=scan.seq))
                self.lose(scan.seq, "encode")
            finally:
                self._scans.task_done()
        self._scans.task_done()

    def _keep(self, scan: WholeScan) -> None:
        cloud = b"" if self._pending[scan.seq] is False else dense_cloud.encode(scan, self._step_m)
        with self._lock:  # an answer comes either before this or finds the file
            is_key = self._pending.pop(scan.seq)
            if is_key is not False:
                self._shelf.put(scan.seq, cloud, bool(is_key))
