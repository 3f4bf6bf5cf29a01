"""`python -m tests.edge_agent.unhurried ARGUMENTS`: the agent, but a run is gone on with however long its start takes.

On a busy machine that may be more than the half minute after which a run is over, which is not what is tested.
"""

from __future__ import annotations

from edge_agent import run_id
from edge_agent.__main__ import main

if __name__ == "__main__":
    run_id.MAX_GAP_S = 600.0
    main()
