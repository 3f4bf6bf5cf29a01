"""Whole scans of keyframes in the store: taken once, of frames that are durable, whether the session goes on or not."""

from __future__ import annotations

import time

from sqlalchemy import Connection, Row, insert, select, update

from map_service import schema
from map_service.catalog import Catalog
from map_service.config import QuotaConfig
from map_service.hello import RefusedError
from map_service.quota import SiteQuotas
from map_service.store import Store
from splitslam.wire import dense_pb2 as pb


class DenseStore:
    """Every method may be called from any thread and raises StoreError."""

    def __init__(self, store: Store, quota: QuotaConfig) -> None:
        self._store, self._quotas, self._every_s = store, SiteQuotas(quota, Catalog(store)), quota.every_s
        self._looked_s = float("-inf")

    def wants(self, session_id: str, offer: pb.CloudOffer) -> pb.UploadResponse:
        """What is to become of a cloud."""
        with self._store.reading() as connection:
            session = _session(connection, session_id)
            verdict = _verdict(connection, session, offer)
        if verdict == pb.CLOUD_VERDICT_WANTED and session is not None:
            return self._room(session.site_id)
        return pb.UploadResponse(verdict=verdict)

    def put(self, session_id: str, offer: pb.CloudOffer, cloud: bytes) -> pb.CloudVerdict:
        """Stores it, if it is still wanted, with one transaction."""
        with self._store.writing() as connection:
            session = _session(connection, session_id, lock=True)
            verdict = _verdict(connection, session, offer)
            if verdict != pb.CLOUD_VERDICT_WANTED or session is None:
                return verdict
            keyframe = _keyframe(connection, session.id, offer)
            row = {"session": session.id, "keyframe": keyframe, "cloud": cloud}
            connection.execute(insert(schema.dense_clouds).values(row))
            t = schema.sessions
            connection.execute(update(t).where(t.c.id == session.id).values(bytes=t.c.bytes + len(cloud)))
        return pb.CLOUD_VERDICT_STORED

    def _room(self, site_id: str) -> pb.UploadResponse:
        """What the sites have stored is asked as seldom as for frames."""
        if self._quotas.any:
            if time.monotonic() - self._looked_s >= self._every_s:
                self._quotas.refresh()
                self._looked_s = time.monotonic()
            try:
                self._quotas.check(site_id)
            except RefusedError as refusal:
                detail, retry_after_ms = refusal.message.detail, refusal.message.retry_after_ms
                return pb.UploadResponse(verdict=pb.CLOUD_VERDICT_NO_ROOM, detail=detail, retry_after_ms=retry_after_ms)
        return pb.UploadResponse(verdict=pb.CLOUD_VERDICT_WANTED)


def _session(connection: Connection, session_id: str, *, lock: bool = False) -> Row | None:
    """lock: a deletion comes before all of the transaction, or after it."""
    t = schema.sessions
    query = select(t.c.id, t.c.site_id, t.c.last_seq, t.c.finished).where(t.c.session_id == session_id)
    return connection.execute(query.with_for_update() if lock else query).first()


def _verdict(connection: Connection, session: Row | None, offer: pb.CloudOffer) -> pb.CloudVerdict:
    if session is None:
        return pb.CLOUD_VERDICT_NO_SESSION
    keyframe = _keyframe(connection, session.id, offer)
    if keyframe is None:
        later = not session.finished and offer.seq > session.last_seq
        return pb.CLOUD_VERDICT_NOT_YET if later else pb.CLOUD_VERDICT_NOT_A_KEYFRAME
    t = schema.dense_clouds
    query = select(t.c.keyframe).where(t.c.session == session.id, t.c.keyframe == keyframe)
    there = connection.execute(query).first() is not None
    return pb.CLOUD_VERDICT_STORED if there else pb.CLOUD_VERDICT_WANTED


def _keyframe(connection: Connection, key: int, offer: pb.CloudOffer) -> int | None:
    """The number of the keyframe that the frame has become."""
    k = schema.keyframes
    query = select(k.c.keyframe).where(k.c.session == key, k.c.seq == offer.seq, k.c.stamp_ns == offer.stamp_ns)
    return connection.execute(query).scalar()
