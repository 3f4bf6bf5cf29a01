"""The agent as a service: the folders that systemd makes for it, and a reload of its configuration."""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from edge_agent.config import ENVIRONMENT_PREFIX, AgentConfig
from splitslam.config import load
from splitslam.errors import InputError
from splitslam.logs import configure_logs, fields
from splitslam.notify import Notifier

_log = logging.getLogger(__name__)


def in_service_folders(config: AgentConfig, environment: Mapping[str, str]) -> AgentConfig:
    """With the folders of systemd.exec(5), where the configuration names none.

    $STATE_DIRECTORY becomes state_dir, and `raw` in $RUNTIME_DIRECTORY, which is in memory, raw_ring.dir.
    """
    if config.state_dir is None and (state := _folder(environment, "STATE_DIRECTORY")):
        config = config.model_copy(update={"state_dir": state})
    if config.raw_ring.dir is None and (runtime := _folder(environment, "RUNTIME_DIRECTORY")):
        ring = config.raw_ring.model_copy(update={"dir": runtime / "raw"})
        config = config.model_copy(update={"raw_ring": ring})
    return config


def _folder(environment: Mapping[str, str], name: str) -> Path | None:
    """The first of those that the variable lists."""
    value = environment.get(name, "").partition(":")[0]
    return Path(value) if value else None


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
            new = in_service_folders(load(AgentConfig, self._path, ENVIRONMENT_PREFIX), os.environ)
        except InputError as error:
            _log.error("not reloaded", extra=fields(detail=str(error)))
            return f"not reloaded: {error}"
        running = self._config
        configure_logs(new.log.format, new.log.level)
        self._config = running.model_copy(update={"log": new.log})
        waiting = changed_keys(running.model_dump(exclude={"log"}), new.model_dump(exclude={"log"}))
        said = {}
        if waiting:
            said["needs_restart"] = ", ".join(waiting)
        _log.warning("reloaded", extra=fields(**said))
        return f"reloaded; for a restart: {', '.join(waiting)}" if waiting else "reloaded"


def changed_keys(old: Mapping[str, Any], new: Mapping[str, Any], prefix: str = "") -> list[str]:
    """Dotted names of the keys whose values differ; both sides have the same keys."""
    changed: list[str] = []
    for key, value in old.items():
        if isinstance(value, dict) and isinstance(new[key], dict) and value.keys() == new[key].keys():
            changed += changed_keys(value, new[key], f"{prefix}{key}.")
        elif value != new[key]:
            changed.append(f"{prefix}{key}")
    return changed
