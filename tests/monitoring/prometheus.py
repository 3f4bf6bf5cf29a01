"""Prometheus and promtool: found, or fetched as Debian's package without root; a server on a free port; its answers."""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import signal
import subprocess
import urllib.error
import urllib.parse
import urllib.request
from contextlib import suppress
from pathlib import Path
from typing import Any, Self

import pytest
import yaml

from splitslam.stack.process import StackProcess, free_port, wait_until
from tests.conftest import ROOT

CACHE = ROOT / "build" / "prometheus"
_FETCH_S, _START_S, _STOP_S, _ASK_S = 240, 20.0, 5.0, 10.0


def binary(name: str) -> Path:
    """`prometheus` or `promtool`. Without it a test is skipped on a laptop and fails in CI."""
    if found := shutil.which(name):
        return Path(found)
    CACHE.mkdir(parents=True, exist_ok=True)
    with (CACHE / "lock").open("w") as lock:  # several test processes want it at once
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (path := CACHE / "usr" / "bin" / name).exists() and (problem := _fetch()):
            reason = f"no {name} here, and Debian's package `prometheus` cannot be fetched: {problem}"
            pytest.fail(reason) if os.environ.get("CI", "").lower() in ("true", "1") else pytest.skip(reason)
    return path


def _fetch() -> str | None:
    """The package into CACHE; why not, or None."""
    if not (shutil.which("apt-get") and shutil.which("dpkg")):
        return "apt-get and dpkg are needed (or put it on the PATH)"
    options: list[str] = []
    said = _run("apt-get", *options, "download", "prometheus")
    if said is not None:  # no package lists, or old ones: ours are as good, and need no root
        for folder in ("lists/partial", "cache/archives/partial"):
            (CACHE / folder).mkdir(parents=True, exist_ok=True)
        options = [f"-oDir::State::Lists={CACHE}/lists", f"-oDir::Cache={CACHE}/cache", "-oAPT::Sandbox::User="]
        said = _run("apt-get", *options, "update") or _run("apt-get", *options, "download", "prometheus")
    packages = sorted(CACHE.glob("prometheus_*.deb"))
    return said or _run("dpkg", "-x", str(packages[-1]), str(CACHE))


def _run(*command: str) -> str | None:
    done = subprocess.run(command, cwd=CACHE, capture_output=True, text=True, timeout=_FETCH_S)
    lines = [line for line in done.stderr.splitlines() if line.startswith("E:")] or [done.stderr.strip()]
    return lines[-1] or f"{command[0]} failed" if done.returncode else None


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
