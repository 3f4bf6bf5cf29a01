"""docker-compose.yml as its tests read it: values with their variables filled in."""

from __future__ import annotations

import re
from typing import Any

import yaml

from tests.conftest import ROOT

FILE = ROOT / "docker-compose.yml"
EXAMPLE = ROOT / ".env.example"
# What an operator has written into .env.
GIVEN = {"POSTGRES_PASSWORD": "made-for-this-test", "GRAFANA_PASSWORD": "another-one"}
COMPOSE = yaml.safe_load(FILE.read_text())
SERVICES: dict[str, dict[str, Any]] = COMPOSE["services"]
_VARIABLE = re.compile(r"\$\{(\w+)(?::([-?])([^}]*))?\}")


def filled(value: Any, given: dict[str, str] | None = None) -> Any:
    """`value` with ${NAME}, ${NAME:-default} and ${NAME:?message} as compose fills them in. KeyError: none of them."""
    variables = GIVEN if given is None else given
    if isinstance(value, dict):
        return {key: filled(item, given) for key, item in value.items()}
    if isinstance(value, list):
        return [filled(item, given) for item in value]
    if not isinstance(value, str):
        return value

    def replaced(match: re.Match[str]) -> str:
        name, kind, default = match.groups()
        return default if kind == "-" and not variables.get(name) else variables[name]

    return _VARIABLE.sub(replaced, value)


def environment(service: str) -> dict[str, str]:
    return filled(SERVICES[service].get("environment", {}))


def mounts(service: str) -> dict[str, str]:
    """Where what lies in the container: target -> source."""
    return {target: source for source, target, *_ in (volume.split(":") for volume in SERVICES[service]["volumes"])}
