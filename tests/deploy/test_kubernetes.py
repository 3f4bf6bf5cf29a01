"""deploy/kubernetes: what kustomize makes of it is valid, and says the same as docker-compose.yml."""

from __future__ import annotations

import copy
import json
import re
import subprocess
from pathlib import Path
from typing import Any

import jsonschema
import kubernetes_validate
import pytest
import yaml

from map_service.config import ENV_PREFIX, ServiceConfig
from map_service.metrics import ServiceMetrics
from splitslam.config import load
from tests import debian
from tests.conftest import ROOT
from tests.deploy import compose
from tests.deploy.dockerfile import Dockerfile

FOLDER = ROOT / "deploy" / "kubernetes"
VERSION = "1.31"  # of the schemas: the oldest that we say we run on
POD_MONITOR = json.loads(Path(__file__).with_name("podmonitor.schema.json").read_text())
OURS = "map-service"


def build(folder: Path) -> list[dict[str, Any]]:
    """`kubectl kustomize`, of the PATH or Debian's."""
    kubectl = debian.binary("kubectl", "kubernetes-client")
    made = subprocess.run((kubectl, "kustomize", folder), capture_output=True, text=True, timeout=60)
    assert made.returncode == 0, made.stderr
    return list(yaml.safe_load_all(made.stdout))


@pytest.fixture(scope="module")
def objects() -> dict[tuple[str, str], dict[str, Any]]:
    return {(made["kind"], re.sub(r"-[a-z0-9]{10}$", "", made["metadata"]["name"])): made for made in build(FOLDER)}


def check(made: dict[str, Any]) -> None:
    """Raises for what the API would refuse, unknown keys among it."""
    if made["kind"] == "PodMonitor":
        jsonschema.validate(made, POD_MONITOR)
    else:
        kubernetes_validate.validate(made, VERSION, strict=True)


def container(objects: dict, name: str = OURS) -> dict[str, Any]:
    (found,) = objects["Deployment", name]["spec"]["template"]["spec"]["containers"]
    return found


def test_every_object_is_valid(objects: dict) -> None:
    assert {kind for kind, _ in objects} >= {
        "Deployment", "Service", "HorizontalPodAutoscaler", "PodDisruptionBudget", "PodMonitor", "NetworkPolicy"
    }  # fmt: skip
    for made in objects.values():
        check(made)


@pytest.mark.parametrize(
    ("which", "path"),
    [
        (("Deployment", OURS), ("spec", "template", "spec")),
        (("HorizontalPodAutoscaler", OURS), ("spec",)),
        (("NetworkPolicy", OURS), ("spec",)),
        (("PodMonitor", OURS), ("spec",)),
    ],
    ids=lambda part: part[0] if isinstance(part, tuple) else str(part),
)
def test_a_key_that_nobody_knows_is_found(objects: dict, which: tuple[str, str], path: tuple[str, ...]) -> None:
    wrong = node = copy.deepcopy(objects[which])
    for key in path:
        node = node[key]
    node["misspelt"] = 1
    with pytest.raises(Exception, match="misspelt"):
        check(wrong)


def test_the_service_is_configured_as_by_compose(objects: dict, monkeypatch: pytest.MonkeyPatch) -> None:
    said = {entry["name"]: entry.get("value") for entry in container(objects)["env"]}
    for key, value in compose.environment("map_service").items():
        assert key in said
        assert said[key] in (value, None), "None: of a secret"
    for key, value in said.items():
        if key.startswith(ENV_PREFIX):
            given = value or "postgresql+psycopg://splitslam:x@db/splitslam"
            monkeypatch.setenv(key, given.replace("$(POD_IP)", "10.0.0.7"))
    config = load(ServiceConfig, None, env_prefix=ENV_PREFIX)
    assert config.replica.address == "10.0.0.7:50051"
    ports = {port["name"]: port["containerPort"] for port in container(objects)["ports"]}
    assert ports == {"grpc": int(config.listen.rpartition(":")[2]), "metrics": config.metrics.port}


def test_nothing_secret_is_in_the_files(objects: dict) -> None:
    assert not [kind for kind, _ in objects if kind == "Secret"]
    (store,) = [entry for entry in container(objects)["env"] if entry["name"] == f"{ENV_PREFIX}__STORE"]
    assert store["valueFrom"] == {"secretKeyRef": {"name": "map-service-store", "key": "url"}}


def test_the_proxy_is_that_of_compose_but_for_the_service_s_name(objects: dict) -> None:
    """A name of a Kubernetes Service has no underscore."""
    theirs = (ROOT / compose.mounts("envoy")["/etc/envoy/envoy.yaml"]).read_text()
    ours = (FOLDER / "proxy" / "envoy.yaml").read_text()
    again = "sed 's/address: map_service,/address: map-service,/' deploy/envoy/envoy-tls.yaml"
    assert ours == theirs.replace("address: map_service,", f"address: {OURS},") != theirs, f"{again} > {FOLDER}/proxy/"
    assert ("Service", OURS) in objects
    assert objects["Service", OURS]["spec"]["clusterIP"] == "None", "one address for each replica"
    for file in (ROOT / "deploy" / "envoy" / "sds").glob("*.yaml"):
        assert (FOLDER / "proxy" / file.name).read_text() == file.read_text()
    assert container(objects, "envoy")["image"] == compose.SERVICES["envoy"]["image"]
    assert container(objects, "envoy")["command"] == compose.SERVICES["envoy"]["command"]


@pytest.mark.parametrize("name", [OURS, "envoy"])
def test_a_pod_is_allowed_in_a_namespace_of_the_restricted_kind(objects: dict, name: str) -> None:
    pod = objects["Deployment", name]["spec"]["template"]["spec"]
    security = container(objects, name)["securityContext"]
    assert pod["securityContext"]["runAsNonRoot"]
    assert pod["securityContext"]["seccompProfile"] == {"type": "RuntimeDefault"}
    assert security == {
        "allowPrivilegeEscalation": False, "readOnlyRootFilesystem": True, "capabilities": {"drop": ["ALL"]}
    }  # fmt: skip
    assert not pod["automountServiceAccountToken"]
    assert set(container(objects, name)["resources"]) == {"requests", "limits"}
    space = objects["Namespace", "splitslam"]["metadata"]["labels"]
    assert space == {"pod-security.kubernetes.io/enforce": "restricted"}


def test_a_pod_runs_as_its_image_says_and_has_the_time_to_drain(objects: dict) -> None:
    image = Dockerfile(ROOT / "deploy" / "docker" / "map_service.Dockerfile")
    pod = objects["Deployment", OURS]["spec"]["template"]["spec"]
    assert f"{pod['securityContext']['runAsUser']}:{pod['securityContext']['runAsGroup']}" == image.all("USER")[-1]
    assert pod["terminationGracePeriodSeconds"] > 10
    assert container(objects)["args"] == image.command("CMD")
    for probe in ("startupProbe", "readinessProbe", "livenessProbe"):
        assert container(objects)[probe]["exec"]["command"][:2] == image.command("HEALTHCHECK")
    mounted = {mount["mountPath"] for mount in container(objects)["volumeMounts"]}
    assert {"/tmp", "/etc/splitslam/tls", *image.all("VOLUME")} == mounted


def test_scaling_goes_by_a_metric_that_the_service_has_and_below_what_a_replica_refuses(
    objects: dict,
) -> None:
    scaler = objects["HorizontalPodAutoscaler", OURS]["spec"]
    (metric,) = [entry["pods"] for entry in scaler["metrics"]]
    workers = next(entry["value"] for entry in container(objects)["env"] if entry["name"].endswith("__WORKERS"))
    config = ServiceConfig(workers=int(workers))
    exported = {family.name for family in ServiceMetrics(config).registry.collect()}
    assert metric["metric"]["name"] in exported
    limit = config.session_limit
    assert 0.5 * limit < int(metric["target"]["averageValue"]) < limit
    assert scaler["scaleTargetRef"]["name"] == OURS
    assert "replicas" not in objects["Deployment", OURS]["spec"], "two would decide"
    assert scaler["minReplicas"] >= 2


def test_what_selects_pods_finds_them(objects: dict) -> None:
    labels = {name: objects["Deployment", name]["spec"]["template"]["metadata"]["labels"] for name in (OURS, "envoy")}
    for (kind, name), made in objects.items():
        spec = made.get("spec", {})
        selector = spec.get("podSelector", spec.get("selector"))
        if selector is None:
            continue
        wanted = selector.get("matchLabels", selector)
        assert wanted.items() <= labels[name].items(), f"{kind} {name}"
    (endpoint,) = objects["PodMonitor", OURS]["spec"]["podMetricsEndpoints"]
    ports = {port["name"] for port in container(objects)["ports"]}
    assert endpoint["port"] in ports
    allowed = [rule["ports"] for rule in objects["NetworkPolicy", OURS]["spec"]["ingress"]]
    assert {port["port"] for rule in allowed for port in rule} == ports
