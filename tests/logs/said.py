"""What was logged, as a search in the logs would find it: the event, and the fields."""

from __future__ import annotations

from typing import Any

import pytest


def said(caplog: pytest.LogCaptureFixture) -> list[tuple[str, dict[str, Any]]]:
    """Every line so far."""
    return [(record.getMessage(), getattr(record, "fields", {})) for record in caplog.records]
