"""The dashboards as code: `python -m deploy.grafana.boards` writes deploy/grafana/dashboards from it."""

from __future__ import annotations

from deploy.grafana.boards.fleet import FLEET
from deploy.grafana.boards.panel import Board
from deploy.grafana.boards.robot import ROBOT
from deploy.grafana.boards.service import SERVICE

BOARDS: dict[str, Board] = {"fleet.json": FLEET, "robot.json": ROBOT, "service.json": SERVICE}
