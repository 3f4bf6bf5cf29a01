"""From a Hello to a session: the one in memory, one built again from the store, or a new one."""

from __future__ import annotations

from collections.abc import Callable

from map_service.accounts import SessionAccounts
from map_service.commits import Committer
from map_service.engine import Engine
from map_service.held import HeldSessions
from map_service.hello import read_hello
from map_service.quota import SiteQuotas
from map_service.session import Session
from map_service.store import FencedError, FinishedError, Store, StoreError
from map_service.tally import Tally
from splitslam.wire import session_pb2 as pb


class Opener:
    """Takes a session over from whoever had it: the store's epoch says that it is ours from now on."""

    def __init__(
        self,
        sessions: HeldSessions,
        engine: Engine,
        store: Store,
        committer: Committer,
        quotas: SiteQuotas,
        tally: Tally,
        cpu_ns: Callable[[], int],
    ) -> None:
        self._sessions, self._engine, self._store, self._committer = sessions, engine, store, committer
        self._quotas, self._tally, self._cpu_ns = quotas, tally, cpu_ns

    def open(self, hello: bytes) -> Session:
        """hello: serialised. Raises RefusedError, FinishedError or StoreError when there is no session for it."""
        request = read_hello(pb.Hello.FromString(hello), self._engine.codec_version)
        if self._committer.away:  # one robot's Hello must not make the others wait
            raise StoreError("commits are being tried again")
        if self._quotas.any:
            self._quotas.refresh()
            self._quotas.check(request.opening.site_id)
        name = request.session_id
        session = self._let_go(name)
        try:
            opened = self._store.open_session(request.opening)
        except FinishedError:
            self._sessions.drop(name)
            raise
        if session is not None and session.take_over(request, opened):
            return session
        self._sessions.drop(name)
        log = self._committer.log(opened.key, opened.epoch, opened.last_seq)
        accounts = SessionAccounts(opened.statistics, self._cpu_ns)
        session = Session(request, log, self._engine, self._store, self._tally, accounts)
        self._sessions.add(session)
        return session

    def _let_go(self, name: str) -> Session | None:
        """The session as it is in memory, without its stream, all of it durable; None: there is none to go on with."""
        session = self._sessions.get(name)
        if session is None:
            return None
        self._sessions.abort(session, "ABORTED", "another stream has opened the session")
        try:
            session.log.flush()
        except (FencedError, StoreError):
            if not session.log.broken:
                raise
            self._sessions.drop(name)
            return None
        return session
