"""The configuration files of both programs for one run: the user's --config, the environment, then the options."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from edge_agent.config import ENVIRONMENT_PREFIX, AgentConfig, split_server
from map_service.config import ENV_PREFIX, ServiceConfig
from splitslam import config
from splitslam.errors import InputError
from splitslam.run.options import RunOptions

# What a run decides by itself.
_EDGE_OWN = ("robot", "server", "source", "output", "state_dir")
_CONNECT_S = 10.0
_RECONNECT_S = 120.0
_MAP_OWN = ("listen", "store")


def configs(options: RunOptions, work: Path) -> tuple[AgentConfig, ServiceConfig]:
    """Effective configurations; files of the run go into `work`. The file has two sections, `edge` and `map`.

    Raises InputError: one line with file (or option), key and what was expected. The agent's `server` is not
    yet the right one when the map service is embedded: its port is known once it listens.
    """
    sections = _sections(options.config)
    edge = config.overlay_environment(AgentConfig, sections["edge"], ENVIRONMENT_PREFIX)
    service = config.overlay_environment(ServiceConfig, sections["map"], ENV_PREFIX)
    name = str(options.config) if options.config else "options"
    return (
        config.validate(AgentConfig, _edge(edge, options, work), f"{name}: edge"),
        config.validate(ServiceConfig, _map(service, work), f"{name}: map"),
    )


def _sections(path: Path | None) -> dict[str, dict[str, Any]]:
    data = {} if path is None else config.parse_yaml(config.read_text(path), str(path))
    sections = {}
    for section, own in (("edge", _EDGE_OWN), ("map", _MAP_OWN)):
        values = data.pop(section, None) or {}
        if not isinstance(values, dict):
            raise InputError(f"{path}: {section}: expected keys and values, found {values!r}")
        if fixed := [key for key in own if key in values]:
            raise InputError(f"{path}: {section}.{fixed[0]}: expected not to be given here, `splitslam run` sets it")
        sections[section] = values
    if data:
        raise InputError(f"{path}: {next(iter(data))}: unknown key; expected the sections edge and map")
    return sections


def _edge(edge: dict[str, Any], options: RunOptions, work: Path) -> dict[str, Any]:
    given = {
        "robot": options.robot.absolute(),
        "source": {
            "recording": options.recording.absolute(),
            "realtime": options.realtime,
            "max_scans": options.max_scans,
        },
        "output": {"dir": work / "agent", "progress": True},
        "state_dir": work / "state",
    }
    if options.server is not None:
        try:
            split_server(options.server)
        except ValueError as error:
            raise InputError(f"--server: {error}, found {options.server!r}") from None
        given["server"] = options.server
    else:
        given |= {"server": "127.0.0.1:1", "tls": {}}  # of the embedded one; which port is not known yet
    if options.disable:
        given["disable"] = options.disable
    if options.deskew is not None:
        given["pipeline"] = {**_section(edge, "pipeline"), "deskew": options.deskew}
    if options.max_kbps is not None:
        given["uplink"] = {**_section(edge, "uplink"), "max_kbps": options.max_kbps}
    # somebody waits for this run: a service that stays away is an error
    patience = {"connect_timeout_s": _CONNECT_S, "reconnect_timeout_s": _RECONNECT_S}
    given["uplink"] = {**patience, **_section({**edge, **given}, "uplink")}
    return {"metrics": {"port": None}, **edge, **given}


def _map(service: dict[str, Any], work: Path) -> dict[str, Any]:
    """One robot needs one worker. Its log goes nowhere but into an error, so what is routine stays out of it."""
    own = {"listen": "127.0.0.1:0", "store": f"sqlite:///{work / 'map.db'}", "tls": {}}
    return {"workers": 1, "metrics": {"port": None}, "log": {"level": "warning"}, **service, **own}


def _section(data: dict[str, Any], name: str) -> dict[str, Any]:
    values = data.get(name)
    return values if isinstance(values, dict) else {}
