"""docker-compose.yml holds together: what it sets is known to the programs, and its parts find each other."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest
import yaml
from sqlalchemy.engine import make_url

from map_service.config import ENV_PREFIX, ServiceConfig
from splitslam.config import load
from tests.conftest import ROOT

COMPOSE = yaml.safe_load((ROOT / "docker-compose.yml").read_text())
SERVICES = COMPOSE["services"]
ENVOY = yaml.safe_load((ROOT / "deploy/envoy/envoy.yaml").read_text())["static_resources"]
DRAIN_S = 10


def interpolated(value: str) -> str:
    """`${NAME:-default}` as compose reads it when NAME is not set."""
    return re.sub(r"\$\{\w+:-([^}]*)\}", r"\1", value)


@pytest.fixture
def config(monkeypatch: pytest.MonkeyPatch) -> ServiceConfig:
    for key, value in SERVICES["map_service"]["environment"].items():
        assert key.startswith(f"{ENV_PREFIX}__")
        monkeypatch.setenv(key, interpolated(value))
    return load(ServiceConfig, None, env_prefix=ENV_PREFIX)


def test_the_proxy_finds_the_replicas_by_the_name_and_port_they_have(config: ServiceConfig) -> None:
    (cluster,) = ENVOY["clusters"]
    (group,) = cluster["load_assignment"]["endpoints"]
    (host,) = group["lb_endpoints"]
    address = host["endpoint"]["address"]["socket_address"]
    assert cluster["type"] == "STRICT_DNS"
    assert address["address"] in SERVICES
    assert config.listen == f"0.0.0.0:{address['port_value']}"


def test_only_the_proxy_is_published_with_the_configuration_of_the_repository() -> None:
    assert [name for name, service in SERVICES.items() if "ports" in service] == ["envoy"]
    (listener,) = ENVOY["listeners"]
    port = listener["address"]["socket_address"]["port_value"]
    assert SERVICES["envoy"]["ports"] == [f"{port}:{port}"]
    (mounted,) = SERVICES["envoy"]["volumes"]
    source, target, mode = mounted.split(":")
    assert (ROOT / source).is_file()
    assert (target, mode) == ("/etc/envoy/envoy.yaml", "ro")


def test_replicas_can_be_many_and_have_the_time_to_drain() -> None:
    service = SERVICES["map_service"]
    assert service["deploy"]["replicas"] >= 2
    assert "container_name" not in service
    assert int(service["stop_grace_period"].removesuffix("s")) > DRAIN_S


def test_the_store_is_the_database_that_is_started_and_its_data_lies_on_a_volume(config: ServiceConfig) -> None:
    url, database = make_url(config.store), SERVICES["postgres"]["environment"]
    assert url.host in SERVICES["map_service"]["depends_on"]
    said = (url.username, url.password, url.database)
    keys = ("POSTGRES_USER", "POSTGRES_PASSWORD", "POSTGRES_DB")
    assert said == tuple(interpolated(database[key]) for key in keys)
    (volume,) = SERVICES["postgres"]["volumes"]
    assert volume.partition(":")[0] in COMPOSE["volumes"]


def test_the_image_has_a_recipe_that_copies_what_there_is() -> None:
    build = SERVICES["map_service"]["build"]
    recipe = ROOT / build["context"] / build["dockerfile"]
    copied = [line.split()[1:-1] for line in recipe.read_text().splitlines() if line.startswith("COPY ")]
    missing = [source for sources in copied for source in sources if not Path(ROOT, source).exists()]
    assert not missing


def test_compose_itself_takes_the_file_where_it_is_installed() -> None:
    commands = (("docker-compose",), ("docker", "compose"))
    found = [command for command in commands if shutil.which(command[0]) and _runs((*command, "version"))]
    if not found:
        pytest.skip("no docker compose here")
    read = subprocess.run(
        [*found[0], "-f", str(ROOT / "docker-compose.yml"), "config", "--format", "json"],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert read.returncode == 0, read.stderr
    assert set(json.loads(read.stdout)["services"]) == set(SERVICES)


def _runs(command: tuple[str, ...]) -> bool:
    return subprocess.run(command, capture_output=True, timeout=60).returncode == 0
