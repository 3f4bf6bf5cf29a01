"""Who else serves the same store: replicas say so in a table there, and know nothing else of each other.

No clock is compared with another machine's: a peer is alive while its count of beats moves.
"""

from __future__ import annotations

import base64
import logging
import socket
import threading
import time
import uuid
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from sqlalchemy import BigInteger, Column, Float, Integer, MetaData, String, Table, delete, insert, select, update
from sqlalchemy.exc import IntegrityError, ProgrammingError

from map_service.config import ReplicaConfig
from map_service.database import StoreError
from map_service.store import Store
from splitslam.logs import fields

_FORGET_BEATS = 60  # a row that has not moved for so long is deleted; its replica, should it live, adds it again

_log = logging.getLogger(__name__)

replicas = Table(
    "replicas",
    MetaData(),  # not the schema's: it holds nothing that must be kept, migrated or copied
    Column("id", String(36), primary_key=True),
    Column("address", String(255), nullable=False),
    Column("started_s", Float, nullable=False),  # for people; nothing is decided by it
    Column("beats", BigInteger, nullable=False),
    Column("sessions", Integer, nullable=False),
)


@dataclass(frozen=True, slots=True, order=True)
class Peer:
    """A replica and how many sessions have a stream there. Ordered by load."""

    sessions: int
    id: str
    address: str


@dataclass(frozen=True, slots=True)
class Peers:
    """All replicas that are alive, this one among them."""

    own_id: str
    alive: tuple[Peer, ...] = ()

    @property
    def spread(self) -> int:
        """Sessions of the fullest replica less those of the emptiest."""
        return max(self.alive).sessions - min(self.alive).sessions if self.alive else 0

    @property
    def is_fullest(self) -> bool:
        """No other has more; of several, one says so."""
        return bool(self.alive) and max(self.alive).id == self.own_id

    def rooms(self, count: int) -> list[str]:
        """Addresses for `count` sessions of this replica, each the emptiest one by then; empty without others."""
        loads = {peer.address: peer.sessions for peer in sorted(self.alive) if peer.id != self.own_id}
        chosen = []
        for _ in range(count if loads else 0):
            address = min(loads, key=lambda a: loads[a])
            loads[address] += 1
            chosen.append(address)
        return chosen


def as_hint(address: str) -> str:
    """HOST:PORT as the proxy wants to read it in a header (Envoy's stateful session)."""
    return base64.b64encode(address.encode()).decode()  # "" stays ""


def own_address(config: ReplicaConfig, listening: str) -> str:
    """HOST:PORT at which the proxy reaches this replica. listening: HOST:PORT that it is bound to."""
    if config.address:
        return config.address
    host, _, port = listening.rpartition(":")
    if host.strip("[]") in ("0.0.0.0", "::", ""):
        host = socket.gethostbyname(socket.gethostname())
    return f"{host}:{port}"


class Membership:
    """One thread that writes this replica's row and reads all of them: `peers`, as of the last look that succeeded."""

    def __init__(
        self,
        store: Store,
        config: ReplicaConfig,
        address: str,
        sessions: Callable[[], int],
        ready: Callable[[], bool] = lambda: True,
    ) -> None:
        """sessions: how many have a stream here; ready: whether one more would be mapped at once, which a replica whose
        workers have died cannot. Called by the thread."""
        self._store, self._config, self._address = store, config, address
        self._sessions, self._ready = sessions, ready
        self._id = str(uuid.uuid4())
        self.peers = Peers(self._id)
        self.looks = 0
        self._seen: dict[str, tuple[int, int]] = {}  # id -> its beats and our look at which they last moved
        self._beats = 0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="membership", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def _run(self) -> None:
        failing = False
        while not self._stop.is_set():
            try:
                self._beat()
                failing = False
            except StoreError as error:
                if not failing:
                    _log.warning("membership failed", extra=fields(detail=str(error)))
                failing = True
            self._stop.wait(self._config.beat_s)

    def _beat(self) -> None:
        if self._beats == 0:
            _make_table(self._store)
        self._beats += 1
        row = {"beats": self._beats, "sessions": self._sessions()}
        own = replicas.c.id == self._id
        with self._store.writing() as connection:
            if not self._ready():  # nobody is sent here meanwhile
                connection.execute(delete(replicas).where(own))
            elif connection.execute(update(replicas).where(own).values(**row)).rowcount == 0:
                connection.execute(
                    insert(replicas).values(id=self._id, address=self._address, started_s=time.time(), **row)
                )
            rows = connection.execute(
                select(replicas.c.id, replicas.c.beats, replicas.c.sessions, replicas.c.address)
            ).all()
            self._look([(id_, beats, Peer(sessions, id_, address)) for id_, beats, sessions, address in rows])
            gone = [id_ for id_, (_, look) in self._seen.items() if self.looks - look >= _FORGET_BEATS]
            if gone:
                connection.execute(delete(replicas).where(replicas.c.id.in_(gone)))

    def _look(self, rows: Sequence[tuple[str, int, Peer]]) -> None:
        """A peer that is new to us counts once it has moved: the rows of the dead are in the table too."""
        self.looks += 1
        alive = []
        for id_, beats, peer in rows:
            known, look = self._seen.get(id_, (beats, self.looks - self._config.lost_beats))
            look = self.looks if beats != known else look
            self._seen[id_] = (beats, look)
            if id_ == self._id or self.looks - look < self._config.lost_beats:
                alive.append(peer)
        self._seen = {id_: self._seen[id_] for id_, _, _ in rows}
        self.peers = Peers(self._id, tuple(alive))

    def leave(self, timeout_s: float) -> None:
        """Takes the row out, so that nobody is sent here any more; waits no longer than that for the store."""
        if not self._thread.is_alive():  # never started: a store that is not shared
            return
        self._stop.set()
        leaver = threading.Thread(target=self._delete, name="membership-leave", daemon=True)
        leaver.start()
        leaver.join(timeout_s)

    def _delete(self) -> None:
        self._thread.join()
        try:
            with self._store.writing() as connection:
                connection.execute(delete(replicas).where(replicas.c.id == self._id))
        except StoreError as error:
            _log.warning("membership not left", extra=fields(detail=str(error)))


def _make_table(store: Store) -> None:
    """Raises StoreError."""
    try:
        with store.writing() as connection:
            replicas.create(connection, checkfirst=True)
    except (IntegrityError, ProgrammingError, StoreError):
        with store.reading() as connection:  # another replica made it in the same moment, or the store fails
            connection.execute(select(replicas.c.id)).all()
