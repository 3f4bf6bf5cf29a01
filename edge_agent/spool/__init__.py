"""Frames on the robot's disk until the map service has them for good."""

from __future__ import annotations

from edge_agent.spool.folder import RunFolder, SpoolFolder
from edge_agent.spool.spool import Spool

__all__ = ["RunFolder", "Spool", "SpoolFolder"]
