"""Housekeeping goes on for as long as the service does."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from map_service.block_keeping import BlockKeeper, Kept
from map_service.config import ServiceConfig
from map_service.database import StoreError
from map_service.housekeeping import Housekeeper, Retention
from map_service.metrics import ServiceMetrics
from map_service.store import Store
from tests.logs.said import said


@pytest.mark.parametrize("error", [StoreError("away"), RuntimeError("a defect")], ids=["store", "defect"])
@pytest.mark.parametrize("failing", [Retention, BlockKeeper, Store])
def test_what_fails_is_logged_ends_nothing_else_and_is_tried_again(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    failing: type,
    error: Exception,
) -> None:
    url = f"sqlite:///{tmp_path}/map.db"
    store, looks = Store(url), {Retention: 0, BlockKeeper: 0, Store: 0}

    def counted(kind: type):
        def run(*_: object):
            looks[kind] += 1
            if kind is failing:
                raise error
            return {Retention: [], BlockKeeper: Kept(), Store: 0}[kind]

        return run

    for kind in looks:
        monkeypatch.setattr(kind, "size_bytes" if kind is Store else "run", counted(kind))
    config = ServiceConfig(store=url, housekeeping_s=0.01)
    metrics = ServiceMetrics(config)

    async def for_a_while() -> None:
        keeping = asyncio.create_task(Housekeeper(store, config, metrics).run())
        done, _ = await asyncio.wait({keeping}, timeout=1.0)
        assert not done
        keeping.cancel()
        await asyncio.gather(keeping, return_exceptions=True)

    asyncio.run(for_a_while())
    assert min(looks.values()) >= 2
    store.close()
    events = {event for event, fields in said(caplog) if fields["detail" if isinstance(error, StoreError) else "task"]}
    assert events == {"housekeeping failed"}
