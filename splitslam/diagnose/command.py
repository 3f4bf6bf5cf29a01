"""What `splitslam diagnose` does: looks at each agent, writes one bundle."""

from __future__ import annotations

import socket
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from splitslam.diagnose import checks, machine, service
from splitslam.diagnose.agent import DEFAULT_STATE, AgentFolder, collect, fetch_metrics, learn, open_folder
from splitslam.diagnose.bundle import Bundle
from splitslam.diagnose.checks import Check
from splitslam.redact import Redactor

_READ_ME = """\
Made by `splitslam diagnose` on {host}, {time}.

summary.json         what was looked at, and how it is
versions.json        SplitSLAM, Python, kernel, packages
edge/, map/          an edge agent (or several), a map service:
  configuration/     effective and as written; without secrets
  agent.json         the last start: version, environment, kernels compiled
  logs/              the journal and files that --log named; without secrets
  metrics.txt        /metrics, when it answered
  raw/               the last seconds as the sensors sent them
  robot.yaml         the sensors

Again, on any machine: splitslam run edge/raw/raw.bag --robot edge/robot.yaml --out results
(a ROS 2 source: edge/raw in place of edge/raw/raw.bag), or splitslam check with the same.
"""


@dataclass(frozen=True, slots=True)
class DiagnoseOptions:
    """edges: state directories of agents here, or http:// addresses of others' metrics; none: the installed agent.

    config: the agent's file, when its state directory does not say. map_config: a map service's file.
    """

    edges: tuple[str, ...] = ()
    config: Path | None = None
    map_config: Path | None = None
    logs: tuple[Path, ...] = ()
    out: Path | None = None
    raw: bool = True


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """found: part of the bundle -> what was looked at there."""

    path: Path
    found: dict[str, list[Check]]

    def as_dict(self) -> dict[str, Any]:
        return {"bundle": str(self.path)} | {
            part: [check.as_dict() for check in found] for part, found in self.found.items()
        }


def diagnose(options: DiagnoseOptions) -> Diagnosis:
    """Raises InputError when there is nothing to look at, or the bundle cannot be written."""
    asked = options.edges or (() if options.map_config else (str(DEFAULT_STATE),))
    folders = [open_folder(Path(edge), options.config) for edge in asked if not _is_url(edge)]
    redactor = Redactor()
    for folder in folders:
        learn(folder, redactor)
    now = datetime.now(UTC)
    path = options.out or Path(f"splitslam-{socket.gethostname()}-{now:%Y%m%dT%H%M%SZ}.zip")
    with Bundle(path, redactor) as bundle:
        found = {"machine": [checks.clock(), checks.memory()]}
        bundle.json("versions.json", machine.versions())
        if options.map_config is not None:
            found["map"] = service.learn_and_collect(options.map_config, bundle, "map")
        found |= _edges(folders, [edge for edge in asked if _is_url(edge)], bundle, options)
        bundle.text("README.txt", _READ_ME.format(host=socket.gethostname(), time=now.isoformat(timespec="seconds")))
        found = {part: [_clean(check, redactor) for check in some] for part, some in found.items()}
        diagnosis = Diagnosis(path, found)
        bundle.json("summary.json", diagnosis.as_dict())
    return diagnosis


def _edges(
    folders: Sequence[AgentFolder], urls: Sequence[str], bundle: Bundle, options: DiagnoseOptions
) -> dict[str, list[Check]]:
    many = len(folders) + len(urls) > 1
    names = [f"edge-{number}" if many else "edge" for number in range(1, len(folders) + len(urls) + 1)]
    found = {
        name: collect(folder, bundle, name, options.logs, options.raw)
        for name, folder in zip(names, folders, strict=False)
    }
    for name, url in zip(names[len(folders) :], urls, strict=True):
        url = url if url.rstrip("/").endswith("/metrics") else f"{url.rstrip('/')}/metrics"
        found[name] = fetch_metrics(url, bundle, name)
    return found


def _is_url(edge: str) -> bool:
    return edge.startswith(("http://", "https://"))


def _clean(check: Check, redactor: Redactor) -> Check:
    return Check(check.name, check.verdict, redactor.text(check.text))
