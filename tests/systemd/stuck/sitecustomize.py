"""Put on PYTHONPATH: an agent whose pipeline hangs at scan $STUCK_AT_SCAN, for as long as it is let.

Its run is gone on with however long the next start takes: on a busy machine more than the half minute it may be else.
"""

from __future__ import annotations

import os
import time
from typing import Any

from edge_agent import run_id

run_id.MAX_GAP_S = 600.0
if at := int(os.environ.get("STUCK_AT_SCAN", "0")):
    from edge_agent.pipeline import EdgePipeline

    process = EdgePipeline.process

    def hold_on(self: EdgePipeline, packet: Any) -> Any:
        while self.seq + 1 == at and packet.scan.stamp_ns > 10**18:  # warm_up has small stamps
            time.sleep(0.1)
        return process(self, packet)

    EdgePipeline.process = hold_on
