"""One map service process of the stack, on an address of its own that it keeps over restarts."""

from __future__ import annotations

import json
import sys
import urllib.request
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from splitslam.stack.process import StackProcess, free_port, wait_until

PROGRAM = (sys.executable, "-m", "map_service")
START_S = 120.0  # the very first start on a machine compiles the kernels
DRAIN_S = 10.0
_ASK_S = 30.0  # on a busy machine


class Replica(StackProcess):
    """`map-service serve`, its workers included: they end with it, and freeze and thaw with it."""

    def __init__(
        self,
        name: str,
        folder: Path,
        store_url: str,
        settings: dict[str, Any] | None = None,
        program: Sequence[str] = PROGRAM,
    ) -> None:
        """settings: of ServiceConfig, over what the stack sets. program: what `serve --config FILE` is given to."""
        super().__init__(name, folder / f"{name}.log")
        self.port, self.metrics_port = free_port(), free_port()
        self.program = tuple(program)  # taken up at the next start: an upgrade
        self._config = folder.absolute() / f"{name}.yaml"
        own = {
            "listen": self.address,
            "store": store_url,
            "workers": 1,
            "metrics": {"port": self.metrics_port},
            "log": {"format": "json"},
        }
        self._config.write_text(yaml.safe_dump({**own, **(settings or {})}))

    @property
    def address(self) -> str:
        return f"127.0.0.1:{self.port}"

    def start(self, wait: bool = True) -> None:
        """wait: until robots can connect. Raises StackError."""
        self._begin = self.log.stat().st_size if self.log.exists() else 0
        self.launch((*self.program, "serve", "--config", self._config))
        if wait:
            self.wait_ready()

    def wait_ready(self, timeout_s: float = START_S) -> None:
        wait_until(lambda: self.ready or not self.alive, timeout_s, f"{self.name} listening (log: {self.log})")
        self.check_alive()

    @property
    def ready(self) -> bool:
        """It has said so since its last start."""
        with self.log.open("rb") as log:
            log.seek(self._begin)
            return b'"event": "listening"' in log.read()

    def drain(self, timeout_s: float = DRAIN_S) -> int | None:
        """SIGTERM: it hands its sessions over and exits. Returns the exit code; it is killed after `timeout_s`."""
        return self.stop(timeout_s)

    def workers(self) -> list[int]:
        """Process ids of its workers since the last start, the newest last."""
        with self.log.open("rb") as log:
            log.seek(self._begin)
            lines = [line for line in log.read().splitlines() if b'"worker ready"' in line]
        return [int(json.loads(line)["pid"]) for line in lines]

    def metrics(self) -> dict[str, float]:
        """Every sample of its /metrics by name and labels."""
        with urllib.request.urlopen(f"http://127.0.0.1:{self.metrics_port}/metrics", timeout=_ASK_S) as page:
            lines = page.read().decode().splitlines()
        return {name: float(value) for name, value in (l.rsplit(" ", 1) for l in lines if not l.startswith("#"))}
