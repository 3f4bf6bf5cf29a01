"""The agent as a service: the folders that systemd makes for it, and a reload of its configuration."""

from __future__ import annotations

import logging
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from edge_agent.config import ENVIRONMENT_PREFIX, AgentConfig
from splitslam.config import load
from splitslam.errors import InputError
from splitslam.logs import configure_logs
from splitslam.notify import Notifier

_log = logging.getLogger(__name__)


def in_service_folders(config: AgentConfig, environment: Mapping[str, str]) -> AgentConfig:
    """With $STATE_DIRECTORY as state_dir when the configuration names none (systemd.exec(5), StateDirectory=)."""
    state = environment.get("STATE_DIRECTORY", "").partition(":")[0]
    if state and config.state_dir is None:
        config = config.model_copy(update={"state_dir": Path(state)})
    return config


class Reloader(threading.Thread):
    """SIGHUP: reads the configuration again and takes over its section `log`; says what else needs a restart.

    A file that cannot be used changes nothing and is said in one line.
    """

    def __init__(self, path: Path, config: AgentConfig, notifier: Notifier) -> None:
        super().__init__(name="reload", daemon=True)
        self._path, self._config, self._notifier = path, config, notifier
        self._asked = threading.Event()

    def ask(self) -> None:
        """Safe in a signal's handler."""
        self._asked.set()

    def run(self) -> None:
        while True:
            self._asked.wait()
            self._asked.clear()
            self._notifier.reloading()
            self._notifier.ready(self._reload())

    def _reload(self) -> str:
        try:
            new = load(AgentConfig, self._path, ENVIRONMENT_PREFIX)
        except InputError as error:
            _log.error("not reloaded: %s", error)
            return f"not reloaded: {error}"
        running = self._config
        if new.state_dir is None:  # what systemd has given stays
            new = new.model_copy(update={"state_dir": running.state_dir})
        configure_logs(new.log.format, new.log.level)
        self._config = running.model_copy(update={"log": new.log})
        waiting = changed_keys(running.model_dump(exclude={"log"}), new.model_dump(exclude={"log"}))
        said = f"reloaded; for a restart: {', '.join(waiting)}" if waiting else "reloaded"
        _log.warning(said)
        return said


def changed_keys(old: Mapping[str, Any], new: Mapping[str, Any], prefix: str = "") -> list[str]:
    """Dotted names of the keys whose values differ; both sides have the same keys."""
    changed: list[str] = []
    for key, value in old.items():
        if isinstance(value, dict) and isinstance(new[key], dict) and value.keys() == new[key].keys():
            changed += changed_keys(value, new[key], f"{prefix}{key}.")
        elif value != new[key]:
            changed.append(f"{prefix}{key}")
    return changed
