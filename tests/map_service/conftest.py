"""A service process, robots and an operator, all closed at the end."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from map_service import postgres as patience
from map_service.store import Store
from tests.map_service.harness import Operator, Robot7, Service, hello, new_run
from tests.postgres import DatabaseServer, database_server


@pytest.fixture(scope="session")
def postgres() -> Iterator[DatabaseServer]:
    server = database_server()
    yield server
    server.close()


@pytest.fixture(params=["sqlite", "postgresql"])
def url(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """Of an empty store: a test that takes it runs on both engines.

    This process is no owner that has gone to sleep when a busy machine keeps it from its transaction for a second.
    """
    if request.param == "sqlite":
        return f"sqlite:///{tmp_path}/map.db"
    for limit in ("STATEMENT_S", "LOCK_S", "ASLEEP_S", "ANSWER_S"):
        monkeypatch.setattr(patience, limit, 60.0)
    return request.getfixturevalue("postgres").empty_database()


@pytest.fixture
def store(url: str) -> Iterator[Store]:
    opened = Store(url)
    yield opened
    opened.close()


@pytest.fixture
def start_service(tmp_path: Path) -> Iterator[Callable[..., Service]]:
    services: list[Service] = []

    def start(**settings: Any) -> Service:
        service = Service(tmp_path, **settings)
        services.append(service)
        service.start()
        return service

    yield start
    for service in services:
        service.close()


@pytest.fixture
def service(start_service: Callable[..., Service]) -> Service:
    return start_service()


@pytest.fixture
def run_id() -> str:
    return new_run()


@pytest.fixture
def session_id(run_id: str) -> str:
    return f"rover-7/{run_id}"


@pytest.fixture
def connect(run_id: str) -> Iterator[Callable[..., Robot7]]:
    """connect(service, **changes of Hello)."""
    robots: list[Robot7] = []

    def open_stream(service: Service, **changes: Any) -> Robot7:
        robots.append(Robot7(service.address, hello(run_id, **changes)))
        return robots[-1]

    yield open_stream
    for robot in robots:
        robot.close()


@pytest.fixture
def operator(service: Service) -> Iterator[Operator]:
    client = Operator(service.address)
    yield client
    client.close()


@pytest.fixture(scope="module")
def shared_service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    """One for tests that leave nothing behind."""
    service = Service(tmp_path_factory.mktemp("service"))
    service.start()
    yield service
    service.close()
