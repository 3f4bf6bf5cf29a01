from __future__ import annotations

import pytest


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sensors of a made graph are there at once."""
    monkeypatch.setattr("edge_agent.ros.sensors._SETTLE_S", 0.1)
    monkeypatch.setattr("edge_agent.ros.source._STATIC_S", 0.2)
