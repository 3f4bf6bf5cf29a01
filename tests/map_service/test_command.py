"""The command `map-service`, as a process."""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest

from map_service.config import ServiceConfig
from splitslam import config
from tests.typed import typed

COMMAND = [sys.executable, "-m", "map_service"]


serve = partial(typed, "map-service", "serve")


def test_options_win_over_the_environment_and_that_over_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "service.yaml"
    file.write_text("listen: 127.0.0.1:1\nworkers: 2\nstore: sqlite:////tmp/file.db\n")
    monkeypatch.setenv("SPLITSLAM_MAP__WORKERS", "4")
    shown = serve("--config", file, "--listen", "127.0.0.1:3", "--print-config")
    assert shown.exit_code == 0, shown.err
    (tmp_path / "effective.yaml").write_text(shown.out)
    effective = config.load(ServiceConfig, tmp_path / "effective.yaml")
    assert (effective.listen, effective.workers, effective.store) == ("127.0.0.1:3", 4, "sqlite:////tmp/file.db")


def test_health_says_which_key_is_missing_when_tls_lets_it_ask_nobody(tmp_path: Path) -> None:
    file = tmp_path / "service.yaml"
    file.write_text("tls: {cert: a.pem, key: a.key, ca: ca.pem}\n")
    asked = typed("map-service", "health", "--config", file)
    assert (asked.exit_code, asked.out) == (2, "")
    assert asked.err == "health_socket: expected a Unix socket's path: with tls nobody answers elsewhere\n"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--listen", "nowhere"], "expected HOST:PORT"),
        (["--store", "nope://x"], "store: nope://x"),
        (["--workers", "many"], "--workers"),
        (["--metrics-port", "70000"], "--metrics-port"),
        (["--config", "/nowhere.yaml"], "/nowhere.yaml"),
    ],
)
def test_a_mistake_is_one_line_and_exit_code_2(tmp_path: Path, arguments: list[str], said: str) -> None:
    failed = serve("--store", f"sqlite:///{tmp_path}/map.db", "--metrics-port", "0", *arguments)
    assert failed.exit_code == 2
    assert said in failed.err
    assert len(failed.err.strip().splitlines()) == 1


def test_an_unknown_key_is_named_with_the_nearest_known_one(tmp_path: Path) -> None:
    file = tmp_path / "service.yaml"
    file.write_text("comit: {every_s: 2}\n")
    failed = serve("--config", file)
    assert failed.exit_code == 2
    assert "comit" in failed.err
    assert "commit" in failed.err


@pytest.mark.parametrize("option", ["--listen", "--metrics-port"])
def test_a_port_that_is_taken_is_said_so_in_one_line(tmp_path: Path, option: str) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        value = f"127.0.0.1:{port}" if option == "--listen" else str(port)
        options = {"--listen": "127.0.0.1:0", "--metrics-port": "0", option: value}
        command = [*COMMAND, "serve", "--store", f"sqlite:///{tmp_path}/map.db"]
        command += [word for option in options.items() for word in option]
        failed = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert failed.returncode == 2
    assert str(port) in failed.stderr
    assert failed.stderr.count("\n") == 1


def test_it_serves_with_the_real_pipeline_says_where_and_stops_at_sigterm(tmp_path: Path) -> None:
    arguments = ["serve", "--listen", "127.0.0.1:0", "--store", f"sqlite:///{tmp_path}/map.db", "--metrics-port", "0"]
    with subprocess.Popen([*COMMAND, *arguments], stdout=subprocess.PIPE, text=True) as service:
        assert service.stdout is not None
        said = json.loads(service.stdout.readline())
        assert said["event"] == "listening"
        for name in ("grpc", "metrics"):
            host, _, port = said[name].partition(":")
            with socket.create_connection((host, int(port)), timeout=30):
                pass
        service.send_signal(signal.SIGTERM)
        assert service.wait(60) == 0
