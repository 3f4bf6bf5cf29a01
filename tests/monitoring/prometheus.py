"""Prometheus and promtool: found, or fetched as Debian's package without root; a server on a free port; its answers."""

from __future__ import annotations

import json
import signal
import urllib.error
import urllib.parse
import urllib.request
from contextlib import suppress
from pathlib import Path
from typing import Any, Self

import yaml

from splitslam.stack.process import StackProcess, free_port, wait_until
from tests import debian

_START_S, _STOP_S, _ASK_S = 60.0, 5.0, 30.0


def binary(name: str) -> Path:
    """`prometheus` or `promtool`. Without it a test is skipped on a laptop and fails in CI."""
    return debian.binary(name, "prometheus")


class Prometheus(StackProcess):
    """A server that scrapes `targets` (by job: HOST:PORT and its labels) every second, with the rules of that file."""

    def __init__(self, folder: Path, targets: dict[str, dict[str, dict[str, str]]], rules: Path | None = None) -> None:
        super().__init__("prometheus", folder / "prometheus.log")
        self.port = free_port()
        self._folder = folder
        self._binary = binary("prometheus")
        config = {
            "global": {"scrape_interval": "1s", "scrape_timeout": "900ms", "evaluation_interval": "1s"},
            "rule_files": [] if rules is None else [str(rules)],
            "scrape_configs": [
                {
                    "job_name": job,
                    "static_configs": [{"targets": [target], "labels": labels} for target, labels in named.items()],
                }
                for job, named in targets.items()
            ],
        }
        (folder / "prometheus.yml").write_text(yaml.safe_dump(config))

    def __enter__(self) -> Self:
        self.launch(
            (
                self._binary,
                f"--config.file={self._folder / 'prometheus.yml'}",
                f"--storage.tsdb.path={self._folder / 'data'}",
                f"--web.listen-address=127.0.0.1:{self.port}",
                "--log.level=warn",
            )
        )
        wait_until(lambda: self._ready() or not self.alive, _START_S, f"prometheus on port {self.port}")
        self.check_alive()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop(_STOP_S, signal.SIGTERM)

    def _ready(self) -> bool:
        with suppress(OSError):
            urllib.request.urlopen(f"http://127.0.0.1:{self.port}/-/ready", timeout=1.0).close()
            return True
        return False

    def ask(self, path: str, **parameters: str | float) -> Any:
        """`data` of an API answer. Raises ValueError with what Prometheus says of a query that it does not take."""
        url = f"http://127.0.0.1:{self.port}/api/v1/{path}?{urllib.parse.urlencode(parameters)}"
        try:
            with urllib.request.urlopen(url, timeout=_ASK_S) as answer:
                return json.load(answer)["data"]
        except urllib.error.HTTPError as error:
            raise ValueError(json.load(error)["error"]) from None

    def series(self, expression: str, from_s: float, to_s: float, step_s: float = 1.0) -> list[list[float]]:
        """The values of every series that the expression gives between two Unix times, NaN among them."""
        found = self.ask("query_range", query=expression, start=from_s, end=to_s, step=step_s)["result"]
        return [[float(value) for _, value in one["values"]] for one in found]
