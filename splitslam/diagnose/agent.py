"""An edge agent of this machine, alive or dead: what is in its state directory, its ring, its log, its metrics."""

from __future__ import annotations

import json
import os
import re
import tempfile
import urllib.error
import urllib.request
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import yaml

from edge_agent.about import NAME, SHOWN
from edge_agent.config import ENVIRONMENT_PREFIX, AgentConfig, split_server
from edge_agent.service import changed_keys
from splitslam import config as configuration
from splitslam.diagnose import checks, machine
from splitslam.diagnose.bundle import Bundle
from splitslam.diagnose.checks import Check, Verdict
from splitslam.diagnose.health import certificate, service_health
from splitslam.diagnose.raw import RawPart, write_raw
from splitslam.errors import InputError
from splitslam.redact import Redactor
from splitslam.security.client import Connector
from splitslam.security.settings import ClientTls

DEFAULT_STATE = Path("/var/lib/splitslam")
DEFAULT_CONFIG = Path("/etc/splitslam/edge.yaml")
DEFAULT_RING = Path("/run/splitslam/raw")
UNIT = "edge-agent"
_FETCH_S = 3.0
_RATE_TOLERANCE = 0.1


@dataclass(frozen=True, slots=True)
class AgentFolder:
    """state_dir and what the agent that ran there last has left: `about` is its agent.json, empty without any.

    problem: why the configuration file cannot be used now, None when it can. written: the file's keys and values.
    effective: what the agent ran with, or would now; empty when neither is known.
    """

    state_dir: Path
    about: dict[str, Any]
    config_file: Path
    written: dict[str, Any]
    problem: str | None
    effective: dict[str, Any]

    @property
    def pid(self) -> int | None:
        """Of the agent, when it is the one that wrote agent.json and still runs."""
        pid = self.about.get("pid")
        try:
            command = Path(f"/proc/{pid}/cmdline").read_bytes()
        except OSError:
            return None
        return pid if b"edge-agent" in command or b"edge_agent" in command else None

    @property
    def ring(self) -> tuple[Path, float]:
        """Folder and seconds of the raw ring."""
        ring = self.effective.get("raw_ring", {})
        return Path(ring.get("dir") or DEFAULT_RING), float(ring.get("seconds", 60.0))


def open_folder(state_dir: Path, config_file: Path | None) -> AgentFolder:
    """Raises InputError when there is neither an agent's state nor a configuration."""
    about = _about(state_dir)
    file = config_file or _config_of(about) or DEFAULT_CONFIG
    written: dict[str, Any] = {}
    problem, effective = None, about.get("config", {})
    try:
        written = configuration.parse_yaml(configuration.read_text(file), str(file))
        now = configuration.load(AgentConfig, file, ENVIRONMENT_PREFIX).model_dump(mode="json")
        effective = effective or now
    except InputError as error:
        problem = str(error)
    if not about and not written:
        raise InputError(f"--edge {state_dir}: no {NAME} there, and {problem}; expected an agent's state directory")
    return AgentFolder(state_dir, about, file, written, problem, effective)


def _about(state_dir: Path) -> dict[str, Any]:
    try:
        about = json.loads((state_dir / NAME).read_text())
    except (OSError, ValueError):
        return {}
    return about if isinstance(about, dict) else {}


def _config_of(about: Mapping[str, Any]) -> Path | None:
    words: Sequence[str] = about.get("command", [])
    for word, value in pairwise([*words, ""]):
        if word == "--config" and value:
            return Path(about.get("folder", "/")) / value
        if word.startswith("--config="):
            return Path(about.get("folder", "/")) / word.partition("=")[2]
    return None


def learn(folder: AgentFolder, redactor: Redactor) -> None:
    """Every secret that this agent's files and its environment hold, before anything is written."""
    redactor.mapping(folder.written)
    redactor.environment(os.environ, ())
    if folder.pid is not None:
        try:
            pairs = Path(f"/proc/{folder.pid}/environ").read_text(errors="replace").split("\0")
            redactor.environment(dict(pair.split("=", 1) for pair in pairs if "=" in pair), ())
        except OSError:  # another user's
            pass
    redactor.environment(machine.unit_environment(UNIT), ())


def collect(folder: AgentFolder, bundle: Bundle, name: str, logs: Sequence[Path], raw: bool) -> list[Check]:
    """Fills the folder `name` of the bundle; returns how things are."""
    found = [_process(folder), *_unit(bundle, name), _configuration(folder)]
    bundle.json(f"{name}/agent.json", folder.about)
    bundle.text(f"{name}/configuration/effective.yaml", _yaml(bundle.redactor.mapping(folder.effective)))
    bundle.text(f"{name}/configuration/file.yaml", _yaml(bundle.redactor.mapping(folder.written)))
    shown = bundle.redactor.environment(os.environ, SHOWN)
    bundle.json(f"{name}/configuration/environment.json", {"agent": folder.about.get("environment"), "here": shown})
    robot_file = _robot_file(folder)
    bundle.text(f"{name}/robot.yaml", robot_file)
    found += [_kernels(folder), *_state(folder, bundle, name), *_network(folder)]
    metrics = folder.about.get("metrics")
    if metrics:
        found += fetch_metrics(metrics, bundle, name)
    found.append(_logs(bundle, name, logs))
    if raw:
        found += _raw(folder, bundle, name, _robot(robot_file))
    return found


def _yaml(data: Mapping[str, Any]) -> str:
    return yaml.safe_dump(dict(data), sort_keys=False, default_flow_style=None, width=120)


def _process(folder: AgentFolder) -> Check:
    if not folder.about:
        return Check("agent", Verdict.WARN, "never started with this state directory")
    said = f"version {folder.about.get('version')}, started {folder.about.get('started')}"
    if folder.pid is None:
        return Check("agent", Verdict.FAIL, f"does not run; the last one: {said}")
    return Check("agent", Verdict.OK, f"runs as process {folder.pid}, {said}")


def _unit(bundle: Bundle, name: str) -> list[Check]:
    state = machine.unit_state(UNIT)
    if state is None:
        return [Check("systemd", Verdict.UNKNOWN, "no systemd here")]
    bundle.text(f"{name}/logs/unit.txt", state)
    keys = dict(line.split("=", 1) for line in state.splitlines() if "=" in line)
    text = ", ".join(f"{key} {keys.get(key, '?')}" for key in ("ActiveState", "SubState", "Result", "NRestarts"))
    return [Check("systemd", Verdict.OK if keys.get("ActiveState") == "active" else Verdict.WARN, text)]


def _configuration(folder: AgentFolder) -> Check:
    if folder.problem is not None:
        return Check("configuration", Verdict.FAIL, folder.problem)
    running = folder.about.get("config")
    if running:
        now = configuration.load(AgentConfig, folder.config_file, ENVIRONMENT_PREFIX).model_dump(mode="json")
        clean = Redactor().mapping(now)
        for key in ("state_dir", "raw_ring"):  # systemd's folders are filled in
            running, clean = {**running, key: None}, {**clean, key: None}
        if running.keys() == clean.keys() and (changed := changed_keys(running, clean)):
            return Check("configuration", Verdict.WARN, f"{folder.config_file}: not in force: {', '.join(changed)}")
    return Check("configuration", Verdict.OK, str(folder.config_file))


def _kernels(folder: AgentFolder) -> Check:
    kernels = folder.about.get("kernels")
    if not kernels:
        return Check("kernels", Verdict.UNKNOWN, "no start to tell")
    text = f"{kernels['compiled']} compiled at the last start, {kernels['seconds']} s"
    if kernels["compiled"]:
        return Check("kernels", Verdict.WARN, f"{text}; expected none: `edge-agent warm-up` fills the cache")
    return Check("kernels", Verdict.OK, text)


def _state(folder: AgentFolder, bundle: Bundle, name: str) -> list[Check]:
    files = [(path, path.stat()) for path in sorted(folder.state_dir.rglob("*")) if path.is_file()]
    listed = [f"{stat.st_size:>12} {stat.st_mtime:.0f} {path.relative_to(folder.state_dir)}" for path, stat in files]
    bundle.text(f"{name}/state.txt", "\n".join(["       bytes changed name", *listed, ""]))
    spool = Path(folder.effective.get("spool", {}).get("dir") or folder.state_dir / "spool")
    kept = list(spool.rglob("*.seg"))
    refused = [path for path in kept if "refused" in path.parts]
    size = sum(path.stat().st_size for path in kept)
    most = int(folder.effective.get("spool", {}).get("max_bytes", 0))
    text = f"{size / 2**20:.1f} MB of {most // 2**20} MB in {len(kept)} files"
    if refused:
        return [Check("spool", Verdict.WARN, f"{text}; the service refused {len(refused)} of them"), _disk(spool, most)]
    return [Check("spool", Verdict.OK, text), _disk(spool, max(0, most - size))]


def _disk(spool: Path, needed_bytes: int) -> Check:
    existing = next(path for path in (spool, *spool.parents) if path.exists())
    return checks.disk("disk", existing, needed_bytes)


def _network(folder: AgentFolder) -> list[Check]:
    server = folder.effective.get("server")
    if not server:
        return [Check("service", Verdict.UNKNOWN, "no address known")]
    found = [checks.reachable("service", *split_server(server))]
    try:
        connector = Connector(server, ClientTls.model_validate(folder.written.get("tls") or {}))
    except (InputError, ValueError) as error:
        return [*found, Check("certificate", Verdict.FAIL, " ".join(str(error).split()))]
    return [*found, *certificate(connector), service_health("service answers", server, connector)]


def fetch_metrics(url: str, bundle: Bundle, name: str) -> list[Check]:
    """A snapshot of /metrics, and what it says of live sensors' clocks."""
    try:
        with urllib.request.urlopen(url, timeout=_FETCH_S) as answer:
            text = answer.read().decode(errors="replace")
    except (OSError, ValueError) as error:
        return [Check("metrics", Verdict.FAIL, f"{url}: {getattr(error, 'reason', error)}; expected an agent there")]
    bundle.text(f"{name}/metrics.txt", text)
    series = sum(not line.startswith("#") for line in text.splitlines())
    return [Check("metrics", Verdict.OK, f"{url}: {series} series"), *sensor_clocks(text)]


def sensor_clocks(page: str) -> list[Check]:
    """Whose time live sensors are stamped in; none without live sensors, or before they have been heard."""
    chosen = dict(re.findall(r'^splitslam_edge_sensor_clock\{sensor="(\w+)",taken_from="(\w+)"\} 1\.0$', page, re.M))
    if not chosen:
        return []
    wrong = re.findall(r"^splitslam_edge_sensor_clock_problems (\S+)$", page, re.M)
    text = ", ".join(f"{sensor} by {taken_from}" for sensor, taken_from in chosen.items())
    if wrong and float(wrong[0]):
        return [Check("sensor clocks", Verdict.WARN, f"{text}; see `sensor clocks disagree` in the log")]
    return [Check("sensor clocks", Verdict.OK, text)]


def _logs(bundle: Bundle, name: str, files: Sequence[Path]) -> Check:
    got = []
    text = machine.journal(UNIT)
    if text is not None:
        bundle.text(f"{name}/logs/journal.txt", text)
        got.append("journal")
    for file in files:
        try:
            bundle.text(f"{name}/logs/{file.name}", machine.tail(file))
        except OSError as error:
            return Check("logs", Verdict.FAIL, f"{file}: {error.strerror}")
        got.append(str(file))
    if not got:
        return Check("logs", Verdict.UNKNOWN, "no journal here; expected --log FILE")
    return Check("logs", Verdict.OK, ", ".join(got))


def _robot_file(folder: AgentFolder) -> str:
    """As the agent used it, or the file that the configuration names."""
    if text := folder.about.get("robot_file"):
        return text
    try:
        return Path(str(folder.effective.get("robot"))).read_text()
    except OSError as error:
        return f"# {error}\n"


def _robot(robot_file: str) -> dict[str, Any]:
    try:
        robot = yaml.safe_load(robot_file)
    except yaml.YAMLError:
        return {}
    return robot if isinstance(robot, dict) else {}


def _raw(folder: AgentFolder, bundle: Bundle, name: str, robot: Mapping[str, Any]) -> list[Check]:
    ring, seconds = folder.ring
    if not ring.is_dir():
        return [Check("raw scans", Verdict.UNKNOWN, f"{ring}: no such folder; `raw_ring` in the configuration")]
    with tempfile.TemporaryDirectory(dir=bundle.path.parent, prefix=".splitslam-") as made:
        part = write_raw(ring, seconds, Path(made))
        if part.path is None:
            return [Check("raw scans", Verdict.WARN, f"{ring}: empty")]
        for file in sorted(part.path.rglob("*")) if part.path.is_dir() else [part.path]:
            bundle.raw(f"{name}/raw/{file.name}", file)
    there = Check("raw scans", Verdict.OK, f"{part.seconds:.1f} s, {sum(part.messages.values())} messages")
    return [there, *_rates(part, robot)]


def _rates(part: RawPart, robot: Mapping[str, Any]) -> list[Check]:
    """What came in the last seconds, against the rate that the robot file states."""
    found = []
    for sensor in ("lidar", "imu", "wheels", "gnss"):
        section = robot.get(sensor)
        topic = section.get("topic") if isinstance(section, dict) else None
        if not isinstance(section, dict) or topic is None:
            continue
        rate_hz, stated_hz = part.rate_hz(topic), section.get("rate_hz")
        text = f"{topic}: nothing" if rate_hz is None else f"{topic}: {rate_hz:.1f} a second"
        if stated_hz is None:
            verdict = Verdict.WARN if rate_hz is None else Verdict.OK
        elif rate_hz is None or abs(rate_hz - stated_hz) > _RATE_TOLERANCE * stated_hz:
            verdict, text = Verdict.FAIL, f"{text}, expected {stated_hz:g}"
        else:
            verdict = Verdict.OK
        found.append(Check(f"{sensor} rate", verdict, text))
    return found
