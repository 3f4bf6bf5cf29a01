"""docs/server.md: what can be typed without a container engine or a cluster is typed, the rest held against files."""

from __future__ import annotations

import os
import re
import shutil
import stat
import subprocess
from pathlib import Path

import yaml

from edge_agent.config import AgentConfig
from splitslam import config
from tests import debian
from tests.conftest import ROOT
from tests.deploy import compose
from tests.deploy.dockerfile import Dockerfile
from tests.deploy.guide import PAGE, commands, type_in


def test_the_secrets_that_it_makes_are_long_each_its_own_and_for_nobody_else_to_read(tmp_path: Path) -> None:
    shutil.copy(compose.EXAMPLE, tmp_path)
    type_in(commands("Secrets"), tmp_path)
    made = tmp_path / ".env"
    values = dict(line.split("=", 1) for line in made.read_text().splitlines() if not line.startswith("#"))
    assert set(values) == set(compose.GIVEN)
    assert all(re.fullmatch("[0-9a-f]{48}", value) for value in values.values())
    assert stat.S_IMODE(made.stat().st_mode) == 0o600


def test_each_container_can_read_its_certificates_and_no_other_s(tmp_path: Path) -> None:
    type_in(commands("Certificates"), tmp_path)
    service = Dockerfile(ROOT / "deploy" / "docker" / "map_service.Dockerfile").all("USER")[-1]
    users = {"envoy": compose.SERVICES["envoy"]["user"], "service": service}
    for name, user in users.items():
        folder = tmp_path / "tls" / name
        assert f"chown -R {user} tls/{name}" in commands("Certificates")
        for file in folder.iterdir():
            assert os.geteuid() or str(file.stat().st_uid) == user.partition(":")[0]
            assert not file.name.endswith(".key") or stat.S_IMODE(file.stat().st_mode) == 0o600
    wanted = {Path(value).name for key, value in compose.environment("map_service").items() if "__TLS__" in key}
    assert {file.name for file in (tmp_path / "tls" / "service").iterdir()} == wanted
    assert {file.name for file in (tmp_path / "tls" / "envoy").iterdir()} == {"envoy.pem", "envoy.key", "ca.pem"}
    assert not list((tmp_path / "tls").rglob("ca.key"))


def test_its_secrets_of_kubernetes_are_those_that_the_pods_mount(tmp_path: Path) -> None:
    """Without a cluster: each command is asked what it would create."""
    kubectl = debian.binary("kubectl", "kubernetes-client")
    for name, files in (("service", "service.pem"), ("envoy", "envoy.pem")):
        (tmp_path / "tls" / name).mkdir(parents=True)
        (tmp_path / "tls" / name / files).write_text("-")
    made = []
    for line in commands("Kubernetes").splitlines():
        words = line.split()
        assert words[0] == "kubectl"
        if words[1] == "create":
            words += ["--dry-run=client", "--output=yaml"]
        else:
            assert words[1:3] == ["apply", "--kustomize"]
            assert (ROOT / words[3] / "kustomization.yaml").is_file()
            continue
        done = subprocess.run((kubectl, *words[1:]), cwd=tmp_path, capture_output=True, text=True, timeout=60)
        assert done.returncode == 0, done.stderr
        made.append(yaml.safe_load(done.stdout))
    text = "".join(file.read_text() for file in (ROOT / "deploy" / "kubernetes").glob("*.yaml"))
    for secret in made[1:]:
        name = secret["metadata"]["name"]
        assert re.search(rf"(secretName|name): {name}\b", text), f"nothing uses the secret {name}"
        assert secret["metadata"]["namespace"] == made[0]["metadata"]["name"]


def test_what_it_says_of_compose_is_what_the_file_has() -> None:
    text = PAGE.read_text()
    for line in commands("Compose").splitlines():
        assert line.startswith("docker compose ")
    named = re.findall(r"(?:--scale |logs --follow |compose exec |compose cp )(\w+)", text)
    assert named
    assert set(named) <= set(compose.SERVICES)
    (volumes,) = re.findall(r"volumes ((?:`\w+`(?:, | and )?)+)", text)
    assert set(re.findall(r"`(\w+)`", volumes)) == set(compose.COMPOSE["volumes"])


def test_the_robot_s_configuration_is_one(tmp_path: Path) -> None:
    (example,) = re.findall(r"^```yaml\n(# agent\.yaml.*?)^```", PAGE.read_text(), re.MULTILINE | re.DOTALL)
    (tmp_path / "agent.yaml").write_text(example)
    agent = config.load(AgentConfig, tmp_path / "agent.yaml", None)
    assert agent.uplink.connect_timeout_s is None
    assert agent.tls.cert is not None
