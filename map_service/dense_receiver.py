"""One robot's upload as plain state: what each message means, and the answer to it. No thread, no socket."""

from __future__ import annotations

from typing import Protocol

from splitslam import dense_cloud
from splitslam.errors import DataError
from splitslam.wire import dense_pb2 as pb


class Clouds(Protocol):
    """map_service.dense_store.DenseStore."""

    def wants(self, session_id: str, offer: pb.CloudOffer) -> pb.UploadResponse: ...
    def put(self, session_id: str, offer: pb.CloudOffer, cloud: bytes) -> pb.CloudVerdict: ...


class DenseReceiver:
    """The clouds of one session, one at a time. `take` raises what the store does; nothing else."""

    def __init__(self, clouds: Clouds, session_id: str) -> None:
        self._clouds, self._session_id = clouds, session_id
        self._offer: pb.CloudOffer | None = None  # what chunks are of
        self._received = bytearray()

    def take(self, request: pb.UploadRequest) -> pb.UploadResponse:
        """The answer. After anything but WANTED the next message is an offer."""
        kind = request.WhichOneof("message")
        answer = (
            self._take_offer(request.offer) if kind == "offer"
            else self._take_chunk(request.chunk) if kind == "chunk"
            else _refused(f"{kind or 'an empty message'}: expected an offer or a chunk")
        )  # fmt: skip
        if answer.verdict != pb.CLOUD_VERDICT_WANTED:
            self._offer, self._received = None, bytearray()
        return answer

    def _take_offer(self, offer: pb.CloudOffer) -> pb.UploadResponse:
        if not 0 < offer.size <= dense_cloud.MAX_BYTES:
            return _refused(f"size {offer.size}: expected 1 to {dense_cloud.MAX_BYTES}")
        if not 0 < offer.seq < 1 << 63:
            return _refused(f"seq {offer.seq}: expected that of a frame")
        self._offer, self._received = offer, bytearray()
        return self._clouds.wants(self._session_id, offer)

    def _take_chunk(self, chunk: pb.CloudChunk) -> pb.UploadResponse:
        offer = self._offer
        if offer is None:
            return _refused("chunk: expected an offer before it")
        received = len(self._received)
        if chunk.offset != received or not 0 < len(chunk.data) <= offer.size - received:
            expected = f"expected up to {offer.size - received} at {received}"
            return _refused(f"chunk of {len(chunk.data)} bytes at {chunk.offset}: {expected}")
        self._received += chunk.data
        if len(self._received) < offer.size:
            return pb.UploadResponse(verdict=pb.CLOUD_VERDICT_WANTED, received_bytes=len(self._received))
        return self._take_whole(offer, bytes(self._received))

    def _take_whole(self, offer: pb.CloudOffer, cloud: bytes) -> pb.UploadResponse:
        try:
            head = dense_cloud.check(cloud)
        except DataError as error:
            return _refused(error.detail)
        if (head.seq, head.stamp_ns) != (offer.seq, offer.stamp_ns):
            return _refused(f"dense cloud of frame {head.seq}, {offer.seq} was offered")
        verdict = self._clouds.put(self._session_id, offer, cloud)
        return pb.UploadResponse(verdict=verdict, received_bytes=len(cloud))


def _refused(detail: str) -> pb.UploadResponse:
    return pb.UploadResponse(verdict=pb.CLOUD_VERDICT_REFUSED, detail=detail)
