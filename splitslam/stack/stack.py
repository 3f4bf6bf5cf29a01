"""The whole stack for as long as a block runs: store, replicas and the proxy that robots connect to."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self

from splitslam.errors import InputError
from splitslam.stack.envoy import EnvoyProxy
from splitslam.stack.postgres import PostgresServer
from splitslam.stack.process import check_stack_installed, wait_until
from splitslam.stack.replica import DRAIN_S, PROGRAM, Replica

_HEALTHY_S = 60.0


def service_tls(folder: Path) -> dict[str, str]:
    """`tls` of a service's configuration with what lies in an authority's folder."""
    files = {"cert": "service.pem", "key": "service.key", "ca": "ca.pem", "tokens": "tokens.yaml"}
    return {key: str(folder / name) for key, name in {**files, "revoked": "revoked.txt"}.items()}


class Stack:
    """`with Stack(folder) as stack:` robots connect to `stack.address`; logs and data lie in `folder`.

    store: "postgres" is a server of its own (`postgres`), "sqlite" a file that all replicas share. settings: of every
    replica's ServiceConfig. program: what `serve --config FILE` is given to.
    tls: an authority's folder with the certificates of service and proxy (splitslam.security.authority); None: no TLS.
    """

    def __init__(
        self,
        folder: Path,
        replicas: int = 3,
        store: Literal["postgres", "sqlite"] = "postgres",
        settings: dict[str, Any] | None = None,
        program: Sequence[str] = PROGRAM,
        tls: Path | None = None,
    ) -> None:
        """Raises InputError without the wheels, or when no replica is wanted."""
        check_stack_installed()
        if replicas < 1:
            raise InputError(f"replicas: expected at least 1, found {replicas}")
        folder.mkdir(parents=True, exist_ok=True)
        self.folder = folder.absolute()
        self.postgres = PostgresServer(self.folder) if store == "postgres" else None
        self.store_url = self.postgres.url if self.postgres else f"sqlite:///{self.folder / 'map.db'}"
        self.envoy = EnvoyProxy(self.folder, tls=tls)
        own = {} if tls is None else {"tls": service_tls(tls.absolute())}
        self._settings, self._program = {**own, **(settings or {})}, program
        self._numbers = itertools.count(1)
        self.replicas = [self._replica() for _ in range(replicas)]

    @property
    def address(self) -> str:
        """HOST:PORT of the proxy."""
        return self.envoy.address

    def __enter__(self) -> Self:
        """Raises StackError when a process does not come up; nothing is left behind then."""
        try:
            if self.postgres:
                self.postgres.start()
            for replica in self.replicas:
                replica.start(wait=False)
            for replica in self.replicas:
                replica.wait_ready()
            self._route()
            self.envoy.start()
            self.wait_healthy()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Ends every process; no data is lost that was durable."""
        for replica in self.replicas:
            replica.kill()
        self.envoy.kill()
        if self.postgres:
            self.postgres.close()

    def add_replica(self, wait: bool = True) -> Replica:
        """One more, known to the proxy from its start on. wait: until it gets streams."""
        replica = self._replica()
        self.replicas.append(replica)
        replica.start(wait=False)
        self._route()
        if wait:
            replica.wait_ready()
            wait_until(lambda: replica.address in self.envoy.healthy(), _HEALTHY_S, f"{replica.name} healthy")
        return replica

    def remove_replica(self, replica: Replica, timeout_s: float = DRAIN_S) -> int | None:
        """Drains it and takes it out; returns its exit code."""
        exit_code = replica.drain(timeout_s)
        self.replicas.remove(replica)
        self._route()
        return exit_code

    def wait_healthy(self, timeout_s: float = _HEALTHY_S) -> None:
        """Until the proxy gives streams to every replica."""
        wanted = {replica.address for replica in self.replicas}
        wait_until(lambda: self.envoy.healthy() == wanted, timeout_s, f"all of {sorted(wanted)} healthy")

    def _replica(self) -> Replica:
        name = f"replica-{next(self._numbers)}"
        return Replica(name, self.folder, self.store_url, self._settings, self._program)

    def _route(self) -> None:
        self.envoy.set_endpoints([replica.address for replica in self.replicas])
