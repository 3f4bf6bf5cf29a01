"""python -m tests.map_service.blocks.stuck_keeper URL MOMENT: stops in the middle of closing a block and says so."""

from __future__ import annotations

import sys
import time

from sqlalchemy import event

from map_service.block_keeping import BlockKeeper
from map_service.block_warm_up import warm_up_blocks
from map_service.config import PosesConfig
from map_service.store import Store

_STATEMENT = {"written": "INSERT INTO pose_blocks", "deleted": "DELETE FROM frames"}


def main(url: str, moment: str) -> None:
    """moment: after which statement."""
    warm_up_blocks()  # PostgreSQL ends a transaction whose owner is away for a second
    store = Store(url)

    def stop(_connection, _cursor, statement: str, *_: object) -> None:
        if statement.startswith(_STATEMENT[moment]):
            print(moment, flush=True)
            time.sleep(60.0)

    event.listen(store.engine, "after_cursor_execute", stop)
    BlockKeeper(store, PosesConfig(full_rate_h=0.0)).run(0.0)


if __name__ == "__main__":
    main(*sys.argv[1:])
