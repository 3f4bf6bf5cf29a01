"""The service with the fake pipeline, in which every fifth frame is a keyframe: 1, 6, 11, ..."""

from tests.map_service.conftest import connect, postgres, run_id, session_id, start_service, store, url

__all__ = ["connect", "postgres", "run_id", "session_id", "start_service", "store", "url"]
