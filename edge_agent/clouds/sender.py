"""Sends what is on the shelf when the link is idle: piece by piece, each when the live stream leaves room for it."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from typing import Protocol

import grpc

from edge_agent.backoff import Backoff
from edge_agent.clouds.shelf import CloudShelf, Kept
from edge_agent.clouds.upload import LOWER_EFFORT, OPTIONS, Upload
from edge_agent.config import split_server
from edge_agent.metrics import EdgeMetrics
from edge_agent.tcp_meter import TcpBytes, TcpMeter
from splitslam import dense_cloud
from splitslam.errors import DataError
from splitslam.logs import fields
from splitslam.security.client import Connector
from splitslam.wire import dense_pb2 as pb

_LARGEST_CHUNK, _SMALLEST_CHUNK = 8192, 1024  # bytes
_CHUNK_S = 0.25  # of a limited uplink
_BYTES_PER_KBIT = 125.0
_LOOK_S = 0.2
_LATER_S = {pb.CLOUD_VERDICT_NOT_YET: 1.0, pb.CLOUD_VERDICT_NO_SESSION: 30.0, pb.CLOUD_VERDICT_NO_ROOM: 30.0}
_UNKNOWN_S = 300.0  # a word of a newer service: it has not said that the cloud is of no use
_FINAL = (pb.CLOUD_VERDICT_REFUSED, pb.CLOUD_VERDICT_WANTED)  # the last: of one that has all of it
_BACKOFF_S = 0.5, 30.0
_log = logging.getLogger(__name__)


class Link(Protocol):
    """edge_agent.uplink.Uplink, what the sender uses of it."""

    @property
    def takes_dense(self) -> bool: ...
    @property
    def limit_kbps(self) -> float | None: ...
    def spare_s(self, size: int) -> float: ...
    def spare_sent(self, size: int) -> None: ...


class CloudSender:
    """One thread; whatever happens to it, clouds stay on the shelf until the service says that it has stored them.

    booked: is told the bytes of each message.
    """

    def __init__(
        self,
        shelf: CloudShelf,
        link: Link,
        server: str,
        connector: Connector,
        metrics: EdgeMetrics,
        booked: Callable[[int], None],
    ) -> None:
        self.sent = 0  # clouds that the service has
        self.moved_s = time.monotonic()  # when a piece was answered last
        self._shelf, self._link, self._connector, self._metrics, self._booked = shelf, link, connector, metrics, booked
        self._meter = TcpMeter(*split_server(server), dscp=LOWER_EFFORT)
        self._attempt = 0
        self._closing = threading.Event()
        self._lock = threading.Lock()
        self._upload: Upload | None = None
        self._thread = threading.Thread(target=self._run, name="dense-sender", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def close(self) -> None:
        """What has not been sent stays where it is."""
        with self._lock:
            self._closing.set()
            if self._upload is not None:
                self._upload.cancel()
        if self._thread.is_alive():
            self._thread.join()
        self._meter.settle()

    def tcp_bytes(self) -> TcpBytes:
        """TCP payload so far."""
        return self._meter.read()

    def _run(self) -> None:
        backoff = Backoff(*_BACKOFF_S)
        channel: grpc.Channel | None = None
        while not self._closing.is_set():
            due = self._shelf.due(time.monotonic()) if self._link.takes_dense else []
            if not due:
                self._closing.wait(_LOOK_S)
                continue
            channel = channel or self._connector.channel(OPTIONS)
            try:
                self._send(channel, due)
                backoff.reset()
                continue
            except (grpc.RpcError, StopIteration) as error:
                if not self._closing.is_set():
                    _log.info("dense clouds: stream broke", extra=fields(detail=_reason(error)))
            except Exception:  # a defect here must cost clouds, not frames
                _log.exception("dense clouds: not sent")
            self._meter.discover()
            channel.close()
            channel = None
            self._attempt += 1
            self._closing.wait(backoff.next_s())
        if channel is not None:
            self._meter.discover()
            channel.close()

    def _send(self, channel: grpc.Channel, due: list[Kept]) -> None:
        """All of them, which are of one run. Raises grpc.RpcError."""
        opening = self._shelf.opening(due[0].run_id)
        upload = Upload(channel, self._connector, opening, self._attempt)
        with self._lock:
            self._upload = upload
            if self._closing.is_set():
                upload.cancel()
        try:
            self._say(upload, pb.UploadRequest(open=opening))
            self._meter.discover()
            for kept in due:
                if self._closing.is_set() or not self._offer(upload, kept):
                    return
        finally:
            with self._lock:
                self._upload = None
            upload.cancel()

    def _offer(self, upload: Upload, kept: Kept) -> bool:
        """One cloud; False: no further one now."""
        if kept.gone_ns is not None:
            return self._ask(upload, kept, kept.gone_ns)
        cloud = self._shelf.read(kept)
        if cloud is None:
            return True
        try:
            head = dense_cloud.check(cloud)
        except DataError as error:
            _log.warning("dense cloud damaged", extra=fields(run_id=kept.run_id, seq=kept.seq, detail=str(error)))
            self._shelf.done(kept, "damaged")
            return True
        offer = pb.CloudOffer(seq=kept.seq, stamp_ns=head.stamp_ns, size=len(cloud))
        answer = self._say(upload, pb.UploadRequest(offer=offer))
        while answer.verdict == pb.CLOUD_VERDICT_WANTED and answer.received_bytes < len(cloud):
            start = answer.received_bytes
            chunk = pb.CloudChunk(offset=start, data=cloud[start : start + self._chunk_bytes()])
            answer = self._say(upload, pb.UploadRequest(chunk=chunk))
            if answer.verdict == pb.CLOUD_VERDICT_WANTED and answer.received_bytes <= start:
                raise ValueError(f"the service has {answer.received_bytes} bytes after {start}")
        return self._take(kept, answer)

    def _ask(self, upload: Upload, kept: Kept, stamp_ns: int) -> bool:
        """Whether a scan that a killed agent had in hand was a keyframe's: then it would be wanted."""
        offer = pb.CloudOffer(seq=kept.seq, stamp_ns=stamp_ns, size=1)
        answer = self._say(upload, pb.UploadRequest(offer=offer))
        if answer.verdict not in (pb.CLOUD_VERDICT_WANTED, pb.CLOUD_VERDICT_NO_ROOM):
            return self._take(kept, answer)
        self._shelf.done(kept, "killed")
        return True

    def _chunk_bytes(self) -> int:
        """A frame that comes right after it waits no longer than for this."""
        limit_kbps = self._link.limit_kbps
        if limit_kbps is None:
            return _LARGEST_CHUNK
        return int(min(max(limit_kbps * _BYTES_PER_KBIT * _CHUNK_S, _SMALLEST_CHUNK), _LARGEST_CHUNK))

    def _say(self, upload: Upload, request: pb.UploadRequest) -> pb.UploadResponse:
        """Waits for its turn, then for the answer."""
        size = request.ByteSize()
        while (wait_s := self._link.spare_s(size)) > 0 and not self._closing.wait(min(wait_s, _LOOK_S)):
            pass
        self._link.spare_sent(size)
        self._booked(size)
        self._metrics.sent("dense", size)
        answer = upload.say(request)
        self._metrics.received("dense", answer.ByteSize())
        if request.HasField("chunk"):
            self.moved_s = time.monotonic()
        return answer

    def _take(self, kept: Kept, answer: pb.UploadResponse) -> bool:
        verdict = answer.verdict
        if verdict == pb.CLOUD_VERDICT_STORED:
            self.sent += 1
            self._shelf.done(kept)
        elif verdict == pb.CLOUD_VERDICT_NOT_A_KEYFRAME:
            self._shelf.done(kept, "not_a_keyframe" if kept.is_key else "")
        elif verdict == pb.CLOUD_VERDICT_NO_SESSION and self._shelf.has_keyframes(kept.run_id):
            self._shelf.give_up(kept.run_id, "deleted")  # it had one
            return False
        elif verdict not in _FINAL:  # no progress: the end of a run need not wait for it
            later_s = _LATER_S.get(verdict)
            if later_s is None:
                said = fields(run_id=kept.run_id, seq=kept.seq, detail=answer.detail or str(verdict))
                _log.info("dense cloud put off by an unknown word", extra=said)
            kept.not_before_s = time.monotonic() + (answer.retry_after_ms * 1e-3 or later_s or _UNKNOWN_S)
        else:
            said = fields(run_id=kept.run_id, seq=kept.seq, detail=answer.detail or str(verdict))
            _log.warning("dense cloud refused", extra=said)
            self._shelf.done(kept, "refused")
        return True


def _reason(error: Exception) -> str:
    if isinstance(error, grpc.Call):
        return f"{error.code().name}: {error.details()}"
    return str(error) or type(error).__name__
