"""docs/security.md can be followed: its commands in their order, then its configurations with the files they made."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import get_args

import pytest
from typer.testing import CliRunner

from edge_agent.config import AgentConfig
from map_service.callers import Reason
from map_service.config import ServiceConfig
from map_service.door import Door
from map_service.metrics import ServiceMetrics
from splitslam import config
from splitslam.cli import app
from splitslam.security.client import Connector
from tests.conftest import ROOT

GUIDE = (ROOT / "docs/security.md").read_text()
BLOCKS = re.findall(r"^```(\w*)\n(.*?)^```$", GUIDE, re.M | re.S)
COMMANDS = [line for kind, block in BLOCKS if not kind for line in block.splitlines()]
YAMLS = [block for kind, block in BLOCKS if kind == "yaml"]


def test_the_set_up_of_the_guide_works_as_it_stands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert len(COMMANDS) > 8
    for command in COMMANDS:
        program, *words = shlex.split(command)
        result = CliRunner().invoke(app, words)
        assert program == "splitslam"
        assert result.exit_code == 0, (command, result.output, result.exception)
    agent_text, service_text = YAMLS
    values = {"robot": "r.yaml", "source": {"recording": "r.bag"}}
    agent = config.validate(AgentConfig, config.parse_yaml(agent_text, "guide") | values, "guide")
    assert Connector(agent.server, agent.tls).expires_s > 0
    service = config.validate(ServiceConfig, config.parse_yaml(service_text, "guide"), "guide")
    metrics = ServiceMetrics(service)
    Door(service.tls, metrics)
    assert metrics.registry.get_sample_value("splitslam_map_certificate_expiry_timestamp_seconds") is not None


def test_every_reason_of_a_refusal_is_in_the_guide() -> None:
    refused = GUIDE[GUIDE.index("## What is refused") : GUIDE.index("## Limits")]
    missing = [reason for reason in get_args(Reason) if f"`{reason}`" not in refused]
    assert not missing


def test_limits_in_the_guide_are_those_of_the_configuration() -> None:
    limits = ServiceConfig().limits
    client = limits.client
    assert f"{limits.max_message_bytes >> 20} MiB" in GUIDE
    assert f"`limits.client.streams`, {client.streams} a robot" in GUIDE
    assert f"`limits.client.opens_per_s`, {client.opens_per_s:g} a robot ({client.opens_burst} at once)" in GUIDE
    assert f"`limits.client.messages_per_s`, {client.messages_per_s:g} a stream" in GUIDE
