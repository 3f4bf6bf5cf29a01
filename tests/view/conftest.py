"""Services and robots for whoever watches; tests that harm none share one, each with a run of its own."""

from __future__ import annotations

import pytest

from tests.map_service.conftest import connect, run_id, session_id, shared_service, start_service
from tests.map_service.harness import Service

__all__ = ["connect", "run_id", "session_id", "shared_service", "start_service"]


@pytest.fixture
def service(shared_service: Service) -> Service:
    return shared_service
