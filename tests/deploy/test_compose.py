"""docker-compose.yml holds together: what it sets is known to the programs, its parts find each other, none can do
more than it must."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from sqlalchemy.engine import make_url

from map_service.config import ENV_PREFIX, ServiceConfig
from splitslam.config import load
from tests import debian
from tests.conftest import ROOT
from tests.deploy.compose import COMPOSE, EXAMPLE, FILE, GIVEN, SERVICES, environment, filled, mounts

ENVOY = yaml.safe_load((ROOT / mounts("envoy")["/etc/envoy/envoy.yaml"]).read_text())["static_resources"]
PROMETHEUS = yaml.safe_load((ROOT / "deploy/prometheus/prometheus.yml").read_text())
DRAIN_S = 10
EACH = pytest.mark.parametrize("name", SERVICES)
# Debian's docker-compose 1.29 needs no engine to read a file, and names a misspelt key.
DOCKER_COMPOSE = (
    "docker-compose", "python3-docker", "python3-dockerpty", "python3-docopt", "python3-dotenv", "python3-jsonschema",
    "python3-requests", "python3-texttable", "python3-websocket", "python3-yaml", "python3-distro",
    "python3-cached-property", "python3-urllib3", "python3-idna", "python3-certifi", "python3-chardet",
    "python3-charset-normalizer", "python3-attr", "python3-pyrsistent", "python3-packaging", "python3-six",
)  # fmt: skip


@pytest.fixture
def config(monkeypatch: pytest.MonkeyPatch) -> ServiceConfig:
    for key, value in environment("map_service").items():
        assert key.startswith(f"{ENV_PREFIX}__")
        monkeypatch.setenv(key, value)
    return load(ServiceConfig, None, env_prefix=ENV_PREFIX)


def compose_config(file: Path, given: dict[str, str]) -> subprocess.CompletedProcess[str]:
    packages = debian.unpacked(*DOCKER_COMPOSE) / "usr/lib/python3/dist-packages"
    run = (
        f"import sys; sys.path.insert(0, {str(packages)!r}); from compose.cli.main import main; "
        f"sys.argv = ['docker-compose', '-f', {str(file)!r}, '--project-directory', {str(ROOT)!r}, 'config']; main()"
    )
    kept = {key: value for key, value in os.environ.items() if key not in GIVEN}
    return subprocess.run(
        (sys.executable, "-I", "-S", "-W", "ignore", "-c", run),
        env={**kept, **given}, cwd=ROOT / "tests", capture_output=True, text=True, timeout=60,
    )  # fmt: skip


def test_compose_itself_takes_the_file_and_reads_it_as_the_tests_do() -> None:
    read = compose_config(FILE, GIVEN)
    assert read.returncode == 0, read.stderr
    services = yaml.safe_load(read.stdout)["services"]
    assert set(services) == set(SERVICES)
    for name in SERVICES:
        assert services[name].get("environment", {}) == environment(name)
        assert services[name].get("command") == SERVICES[name].get("command")


def test_compose_names_a_misspelt_key_and_a_variable_that_nobody_set(tmp_path: Path) -> None:
    wrong = tmp_path / "docker-compose.yml"
    wrong.write_text(FILE.read_text().replace("stop_grace_period", "stop_grace_perod"))
    assert "stop_grace_perod" in compose_config(wrong, GIVEN).stderr
    unset = compose_config(FILE, {})
    assert unset.returncode != 0
    assert "is not set, see .env.example" in unset.stderr


def test_what_must_be_given_is_in_the_example_and_nothing_that_is_secret_has_a_default() -> None:
    asked = set(re.findall(r"\$\{(\w+)", FILE.read_text()))
    offered = {line.partition("=")[0]: line.partition("=")[2] for line in EXAMPLE.read_text().split() if "=" in line}
    assert asked == set(GIVEN) <= set(offered)
    assert all(offered[name] == "" for name in asked)
    assert not re.search(r"\$\{\w+:-", FILE.read_text())
    ignored = (ROOT / ".gitignore").read_text().split()
    assert {"/.env", "/tls/"} <= set(ignored)


def test_the_proxy_finds_the_replicas_by_the_name_and_port_they_have(config: ServiceConfig) -> None:
    (cluster,) = ENVOY["clusters"]
    (group,) = cluster["load_assignment"]["endpoints"]
    (host,) = group["lb_endpoints"]
    address = host["endpoint"]["address"]["socket_address"]
    assert cluster["type"] == "STRICT_DNS"
    assert address["address"] in SERVICES
    assert config.listen == f"0.0.0.0:{address['port_value']}"


def test_prometheus_finds_the_replicas_by_the_name_and_port_they_have(config: ServiceConfig) -> None:
    (names,) = [job["dns_sd_configs"][0] for job in PROMETHEUS["scrape_configs"] if "dns_sd_configs" in job]
    assert set(names["names"]) <= set(SERVICES)
    assert (config.metrics.host, config.metrics.port) == ("0.0.0.0", names["port"])


def test_robots_come_in_by_the_proxy_alone_and_only_with_certificates(config: ServiceConfig) -> None:
    (listener,) = ENVOY["listeners"]
    port = listener["address"]["socket_address"]["port_value"]
    assert SERVICES["envoy"]["ports"] == [f"{port}:{port}"]
    others = [port for name, service in SERVICES.items() if name != "envoy" for port in service.get("ports", [])]
    assert all(port.startswith("127.0.0.1:") for port in others)
    (chain,) = listener["filter_chains"]
    assert chain["transport_socket"]["typed_config"]["require_client_certificate"] is True
    assert config.tls.on
    assert config.tls.clients == "certificate"


@EACH
def test_what_a_service_mounts_from_the_checkout_is_there_and_read_only(name: str) -> None:
    for volume in SERVICES[name].get("volumes", []):
        source, _, *mode = volume.split(":")
        if source.startswith("./tls/"):  # made by the operator: docs/server.md
            assert mode == ["ro"]
        elif source.startswith("."):
            assert (ROOT / source).exists()
            assert mode == ["ro"]
        else:
            assert source in COMPOSE["volumes"], "data lies on a volume that outlives the container"


@EACH
def test_a_service_runs_as_nobody_special_and_can_take_no_more_than_its_share(name: str) -> None:
    service = SERVICES[name]
    user = service.get("user") or re.findall(r"^USER (.*)", _recipe(name), re.MULTILINE)[-1]
    assert int(user.partition(":")[0]) > 0
    assert service["read_only"]
    assert service["cap_drop"] == ["ALL"]
    assert "cap_add" not in service
    assert "privileged" not in service
    assert service["security_opt"] == ["no-new-privileges:true"]
    assert set(service["deploy"]["resources"]["limits"]) == {"cpus", "memory"}
    assert "healthcheck" in service or "HEALTHCHECK" in _recipe(name)
    image = service["image"]
    assert "build" in service or re.fullmatch(r"[\w./-]+:v?\d+\.\d+(\.\d+)?", image), f"{image}: not of one version"


def _recipe(name: str) -> str:
    build = SERVICES[name].get("build")
    return (ROOT / build["context"] / build["dockerfile"]).read_text() if build else ""


def test_replicas_can_be_many_and_have_the_time_to_drain() -> None:
    service = SERVICES["map_service"]
    assert service["deploy"]["replicas"] >= 2
    assert "container_name" not in service
    assert "ports" not in service
    assert int(service["stop_grace_period"].removesuffix("s")) > DRAIN_S


def test_the_store_is_the_database_that_is_started(config: ServiceConfig) -> None:
    url, database = make_url(config.store), environment("postgres")
    assert url.host in SERVICES["map_service"]["depends_on"]
    said = (url.username, url.password, url.database)
    assert said == tuple(database[key] for key in ("POSTGRES_USER", "POSTGRES_PASSWORD", "POSTGRES_DB"))


def test_the_database_has_no_way_out_of_the_rack() -> None:
    assert COMPOSE["networks"]["rack"] == {"internal": True}
    assert SERVICES["postgres"]["networks"] == SERVICES["map_service"]["networks"] == ["rack"]


def test_grafana_tells_nobody_that_it_is_there() -> None:
    said = environment("grafana")
    assert {said[key] for key in said if key.startswith("GF_ANALYTICS")} == {"false"}
    assert filled(said["GF_SECURITY_ADMIN_PASSWORD"]) == GIVEN["GRAFANA_PASSWORD"]
