"""Writes every board's JSON to where Grafana is told to look for it."""

from __future__ import annotations

from pathlib import Path

from deploy.grafana.boards.build import as_json
from deploy.grafana.boards.fleet import FLEET
from deploy.grafana.boards.robot import ROBOT
from deploy.grafana.boards.service import SERVICE

FOLDER = Path(__file__).parent.parent / "dashboards"
BOARDS = {"fleet.json": FLEET, "robot.json": ROBOT, "service.json": SERVICE}


def main() -> None:
    for name, board in BOARDS.items():
        (FOLDER / name).write_text(as_json(board))
        print(FOLDER / name)


if __name__ == "__main__":
    main()
