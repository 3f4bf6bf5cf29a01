"""The service with the fake pipeline, in which every fifth frame is a keyframe: 1, 6, 11, ..."""

import pytest

from tests.map_service.conftest import connect, postgres, run_id, session_id, shared_service, start_service, url
from tests.map_service.harness import Service

__all__ = ["connect", "postgres", "run_id", "session_id", "shared_service", "start_service", "url"]


@pytest.fixture
def service(shared_service: Service) -> Service:
    """One for tests whose robots do not meet."""
    return shared_service
