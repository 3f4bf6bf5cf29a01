"""What an agent was started with, kept beside its run for whoever looks at it later, alive or not."""

from __future__ import annotations

import json
import logging
import os
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from edge_agent.config import AgentConfig
from edge_agent.kernel_cache import KernelReport
from splitslam import __version__
from splitslam.logs import fields
from splitslam.redact import Redactor
from splitslam.robot import Robot, robot_to_yaml

NAME = "agent.json"
SHOWN = ("SPLITSLAM_", "NUMBA_", "OMP_", "GRPC_", "LANG", "TZ", "WATCHDOG_", "STATE_", "RUNTIME_", "CACHE_")
_log = logging.getLogger(__name__)


def write_about(config: AgentConfig, robot: Robot, kernels: KernelReport, metrics_port: int | None) -> None:
    """`agent.json` in the state directory, if there is one: no secrets are in it. A disk that fails is logged."""
    if config.state_dir is None:
        return
    try:
        config.state_dir.mkdir(parents=True, exist_ok=True)
        part = config.state_dir / f"{NAME}.part"
        part.write_text(json.dumps(_about(config, robot, kernels, metrics_port), indent=1))
        part.replace(config.state_dir / NAME)
    except OSError as error:
        _log.warning("start not noted", extra=fields(file=NAME, detail=str(error)))


def _about(config: AgentConfig, robot: Robot, kernels: KernelReport, metrics_port: int | None) -> dict[str, Any]:
    redactor = Redactor()
    environment = redactor.environment(os.environ, SHOWN)
    effective = redactor.mapping(config.model_dump(mode="json"))
    host = config.metrics.host
    return {
        "version": __version__,
        "pid": os.getpid(),
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        "boot_id": Path("/proc/sys/kernel/random/boot_id").read_text().strip(),
        "command": [redactor.text(word) for word in sys.argv],
        "folder": str(Path.cwd()),
        "environment": environment,
        "config": effective,
        "robot_file": redactor.text(robot_to_yaml(robot)),
        "metrics": None if metrics_port is None else f"http://{host}:{metrics_port}/metrics",
        "kernels": kernels.as_dict(),
    }
