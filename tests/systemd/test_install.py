"""install.sh: from a wheel to a running agent, to the next version and back, and what it says when it cannot."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sysconfig
from pathlib import Path

import pytest

from edge_agent.config import AgentConfig
from edge_agent.kernel_cache import fill
from map_service.config import ServiceConfig
from splitslam.config import load
from tests.edge_agent.test_daemon import standing_service
from tests.systemd.manager import Manager
from tests.systemd.unit import UNITS
from tests.systemd.wheels import borrow_kernels, build_wheel

FIRST, SECOND = "0.1.0", "0.1.1"
SCANS = 40
PACKAGES = sysconfig.get_path("purelib")


def install(*arguments: str | Path, path: Path | None = None, **environment: str) -> subprocess.CompletedProcess[str]:
    """path: a folder of programs that come before the machine's."""
    known = {"PATH": f"{path}:{os.environ['PATH']}" if path else os.environ["PATH"], "LANG": "C.UTF-8"}
    command = [str(UNITS / "install.sh"), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=400, env=known | environment)


def installed(*arguments: str | Path) -> str:
    done = install(*arguments)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def wheels(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("wheels")
    return {version: build_wheel(folder, version) for version in (FIRST, SECOND)}


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory, wheels: dict[str, Path]) -> Path:
    """Both versions, the second one current."""
    root = tmp_path_factory.mktemp("root")
    for version in (FIRST, SECOND):
        installed(wheels[version], "--root", root, "--packages-from", PACKAGES, "--no-kernels")
    return root


def current(root: Path, name: str = "current") -> str:
    return os.readlink(root / "opt/splitslam" / name)


def tree(root: Path) -> dict[str, tuple[int, str]]:
    """Every file: when it was written, where a link leads."""
    return {
        str(path): (path.lstat().st_mtime_ns, os.readlink(path) if path.is_symlink() else "")
        for path in root.rglob("*")
        if path.name != ".lock"
    }


def test_an_upgrade_keeps_the_spool_and_sends_what_is_in_it_and_a_roll_back_is_one_step(
    wheels: dict[str, Path], shared_data: Path, tmp_path: Path
):
    at = ("--root", tmp_path, "--packages-from", PACKAGES)
    said = installed(wheels[FIRST], *at, "--no-kernels")
    assert "edge.yaml is an example" in said
    folder, cache = tmp_path / "opt/splitslam", tmp_path / "var/cache/splitslam"
    load(AgentConfig, tmp_path / "etc/splitslam/edge.yaml")
    fill(None)  # this checkout's own, for every test
    assert borrow_kernels(folder / FIRST, cache / FIRST) > 100
    said = installed(wheels[FIRST], *at)  # again: it goes on where the first one was told to stop
    assert f"{FIRST} is installed already" in said
    assert '"compiled": 0' in said, "the kernels are not found where the service looks for them"

    with standing_service() as away:
        pass  # a port where nobody listens any more
    config = {
        "robot": str(shared_data / "yard1" / "yard1.yaml"),
        "server": away.address,
        "source": {"recording": str(shared_data / "yard1" / "yard1.bag"), "realtime": True, "max_scans": SCANS},
        "metrics": {"port": None},
        "uplink": {"connect_timeout_s": None},
    }
    written = tmp_path / "etc/splitslam/edge.yaml"
    written.write_text(json.dumps(config))
    manager = Manager(tmp_path, folder / "current" / "bin")
    try:
        manager.start(NUMBA_CACHE_DIR=str(cache / FIRST))
        spool = manager.state / "spool"
        manager.until(lambda: sum(file.stat().st_size for file in spool.glob("*/*.seg")) > 30_000, "no spool")
        manager.send(signal.SIGTERM)
        assert manager.wait() == 0
        before = tree(manager.state)

        installed(wheels[SECOND], *at, "--no-kernels")
        assert (current(tmp_path), current(tmp_path, "previous")) == (SECOND, FIRST)
        assert tree(manager.state) == before
        assert json.loads(written.read_text()) == config
        borrow_kernels(folder / SECOND, cache / SECOND)
        with away:
            manager.start(NUMBA_CACHE_DIR=str(cache / SECOND))
            assert manager.wait() == 0, manager.log.read_text()[-2000:]
            assert "continued after scan" in manager.log.read_text()
            assert sorted(away.applied) == list(range(1, SCANS + 1))
            assert away.holes == []
            assert {hello.agent_version for hello in away.hellos} == {SECOND}
    finally:
        manager.close()

    installed("--rollback", "--root", tmp_path)
    assert (current(tmp_path), current(tmp_path, "previous")) == (FIRST, SECOND)
    said = subprocess.run([folder / "current/bin/edge-agent", "--version"], capture_output=True, text=True)
    assert said.stdout == f"{FIRST}\n"


def test_the_examples_of_both_configurations_are_valid():
    load(AgentConfig, UNITS / "edge.yaml")
    load(ServiceConfig, UNITS / "map.yaml")


def test_a_dry_run_says_what_it_would_do_and_does_nothing(root: Path, wheels: dict[str, Path], tmp_path: Path):
    before = tree(root)
    said = installed(wheels[FIRST], "--root", root, "--packages-from", PACKAGES, "--dry-run")
    assert f"would: mv -T {root}/opt/splitslam/.current {root}/opt/splitslam/current" in said
    assert tree(root) == before
    said = installed(wheels[FIRST], "--root", tmp_path, "--wheelhouse", tmp_path, "--dry-run")
    assert "-m venv" in said
    assert f"--no-index --find-links {tmp_path}" in said
    assert not list(tmp_path.iterdir())


def test_a_version_that_does_not_start_is_taken_back(root: Path, wheels: dict[str, Path], tmp_path: Path):
    calls = tmp_path / "calls"
    fake = tmp_path / "systemctl"
    bad = tmp_path / "bad"  # the first restart fails
    fails = f'[ "$1" != restart ] || [ ! -e {bad} ] || {{ rm {bad}; exit 1; }}'
    fake.write_text(f'#!/bin/sh\necho "$@" >> {calls}\n{fails}\n')
    fake.chmod(0o755)
    bad.touch()
    assert current(root) == SECOND
    done = install(
        *(wheels[FIRST], "--root", root, "--packages-from", PACKAGES, "--no-kernels"), SPLITSLAM_SYSTEMCTL=str(fake)
    )
    assert done.returncode == 1
    assert done.stderr == f"install.sh: {FIRST} does not start, {SECOND} is back: journalctl -u edge-agent\n"
    assert current(root) == SECOND
    assert [call.split()[0] for call in calls.read_text().splitlines()] == [
        *("enable", "daemon-reload", "is-active", "restart"),
        *("daemon-reload", "restart"),
    ]


@pytest.fixture
def bad(wheels: dict[str, Path], tmp_path: Path) -> dict[str, Path]:
    """Wheels with something wrong."""
    whole = wheels[FIRST].read_bytes()
    named = {"cut": "splitslam-0.1.2-py3-none-any.whl", "other": wheels[FIRST].name, "name": "splitslam.zip"}
    files = {kind: tmp_path / kind / name for kind, name in named.items()}
    for file in files.values():
        file.parent.mkdir()
    files["cut"].write_bytes(whole[: len(whole) // 2])
    files["other"].write_bytes(whole + b" ")
    files["name"].write_bytes(whole)
    return files


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        ((), "expected a wheel or --rollback (see --help)"),
        (("missing.whl",), "missing.whl: no such file; expected splitslam-VERSION-py3-none-any.whl"),
        (("{name}",), "{name}: expected splitslam-VERSION-py3-none-any.whl"),
        (("{cut}",), "{cut}: damaged: not a whole zip file"),
        (("{other}",), "0.1.0 is installed from another wheel of that version; expected one with a version of its own"),
        (("{good}", "--wheelhuose", "x"), "unknown option --wheelhuose (see --help)"),
        (("{good}", "--wheelhouse", "nowhere"), "--wheelhouse nowhere: no such folder"),
        (("{good}", "--rollback"), "--rollback takes no wheel"),
        (("{good}", "--python", "false"), "--python false: expected Python 3.11 or 3.12 with the venv module"),
        (
            ("{good}", "--with-fpga", "--python", "python3"),
            "--with-fpga: no pynq for python3; expected PYNQ 4.0's Python (--python)",
        ),
    ],
)
def test_what_cannot_be_done_is_one_line_and_changes_nothing(
    arguments: tuple[str, ...], line: str, root: Path, wheels: dict[str, Path], bad: dict[str, Path]
):
    files = {kind: str(path) for kind, path in bad.items()} | {"good": str(wheels[FIRST])}
    before = tree(root / "opt")
    done = install(*(argument.format(**files) for argument in arguments), "--root", root)
    assert done.returncode == 2
    assert done.stderr == f"install.sh: {line.format(**files)}\n"
    assert tree(root / "opt") == before


@pytest.mark.parametrize(
    ("program", "prints", "line"),
    [
        ("uname", "armv7l", r"armv7l: expected x86_64 or aarch64"),
        ("df", "Filesystem x\nx 0 0 300 0%", r"\S+: 300 MB are free, expected \d+"),
    ],
)
def test_a_machine_that_does_not_fit_is_refused(
    program: str, prints: str, line: str, wheels: dict[str, Path], tmp_path: Path
):
    (tmp_path / "bin").mkdir()
    fake = tmp_path / "bin" / program
    fake.write_text(f"#!/bin/sh\necho '{prints}'\n")
    fake.chmod(0o755)
    done = install(wheels[FIRST], "--root", tmp_path, path=tmp_path / "bin")
    assert done.returncode in (1, 2)
    assert re.fullmatch(rf"install\.sh: {line}( MB)?\n", done.stderr), done.stderr
    assert not (tmp_path / "opt/splitslam/current").exists()


def test_a_wheelhouse_without_a_package_is_said_by_name_and_the_next_try_starts_anew(
    wheels: dict[str, Path], tmp_path: Path
):
    done = install(wheels[FIRST], "--root", tmp_path, "--wheelhouse", tmp_path)
    assert done.returncode == 1
    assert re.match(r"install\.sh: pip: ERROR: .*(gtsam|grpcio|numba)", done.stderr), done.stderr
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "opt/splitslam/current").exists()
    installed(wheels[FIRST], "--root", tmp_path, "--packages-from", PACKAGES, "--no-kernels")
    assert current(tmp_path) == FIRST


def test_a_configuration_that_the_new_version_does_not_take_is_said_before_anything_is_switched(
    root: Path, wheels: dict[str, Path]
):
    config = root / "etc/splitslam/edge.yaml"
    good = config.read_text()
    config.write_text(good + "uplnik: {}\n")
    try:
        done = install(wheels[FIRST], "--root", root, "--packages-from", PACKAGES, "--no-kernels")
    finally:
        config.write_text(good)
    assert done.returncode == 2
    assert done.stderr == f"install.sh: {FIRST}: {config}: uplnik: unknown key; nearest known: uplink\n"
    assert current(root) == SECOND
