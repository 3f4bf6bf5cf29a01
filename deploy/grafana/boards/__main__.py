"""Writes every board's JSON to where Grafana is told to look for it."""

from __future__ import annotations

from pathlib import Path

from deploy.grafana.boards import BOARDS
from deploy.grafana.boards.build import as_json

FOLDER = Path(__file__).parent.parent / "dashboards"

for name, board in BOARDS.items():
    (FOLDER / name).write_text(as_json(board))
    print(FOLDER / name)
