"""Does a running agent answer? Its /metrics, asked on the robot itself: for containers."""

from __future__ import annotations

import urllib.error
import urllib.request

_OURS = b"splitslam_edge_"


def problem_with(metrics: str, timeout_s: float = 2.0) -> str | None:
    """Why the agent whose /metrics are at HOST:PORT is not well, or None."""
    try:
        with urllib.request.urlopen(f"http://{metrics}/metrics", timeout=timeout_s) as page:
            body = page.read()
    except (OSError, ValueError) as error:
        reason = error.reason if isinstance(error, urllib.error.URLError) else error
        return f"edge agent: no /metrics at {metrics} within {timeout_s:g} s ({reason})"
    return None if _OURS in body else f"edge agent: what answers at {metrics} is none"
