"""install.sh: from a wheel to a running agent, to the next version and back, and what it says when it cannot."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import sysconfig
import time
import zipfile
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
EXECUTABLES = Path(sys.executable).parent


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


@pytest.fixture
def empty(tmp_path: Path) -> dict[str, Path]:
    """Wheels of both versions that hold nothing but what they need."""
    found = {}
    for version in (FIRST, SECOND):
        found[version] = tmp_path / "wheels" / f"splitslam-{version}-py3-none-any.whl"
        found[version].parent.mkdir(exist_ok=True)
        about = f"splitslam-{version}.dist-info"
        with zipfile.ZipFile(found[version], "w") as wheel:
            text = f"Metadata-Version: 2.1\nName: splitslam\nVersion: {version}\nProvides-Extra: edge\n"
            wheel.writestr(f"{about}/METADATA", f"{text}Requires-Dist: gtsam>=4.3.0\n")
            wheel.writestr(f"{about}/WHEEL", "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n")
            wheel.writestr(f"{about}/RECORD", "")
    return found


@pytest.fixture
def root(tmp_path: Path, empty: dict[str, Path]) -> Path:
    """As if both had been installed, the second one last; their programs are this checkout's."""
    root = tmp_path / "root"
    (root / "etc/splitslam").mkdir(parents=True)
    (root / "etc/splitslam/edge.yaml").write_text((UNITS / "edge.yaml").read_text())
    for version, wheel in empty.items():
        folder = root / "opt/splitslam" / version
        shutil.copytree(UNITS, folder / "systemd")
        (folder / "bin").symlink_to(EXECUTABLES)
        (folder / "installed").write_text(f"{hashlib.sha256(wheel.read_bytes()).hexdigest()}\n")
    (root / "opt/splitslam/.lock").touch()
    (root / "opt/splitslam/current").symlink_to(SECOND)
    (root / "opt/splitslam/previous").symlink_to(FIRST)
    return root


def program(path: Path, text: str) -> Path:
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)
    return path


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
        run = json.loads((manager.state / "run.json").read_text())  # a busy machine may have taken more than 30 s
        run["since_boot_s"] = time.clock_gettime(time.CLOCK_BOOTTIME)
        (manager.state / "run.json").write_text(json.dumps(run))
        with away:
            manager.start(NUMBA_CACHE_DIR=str(cache / SECOND))
            assert manager.wait() == 0, manager.log.read_text()[-2000:]
            assert "run continued" in manager.log.read_text()
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


def test_a_dry_run_says_what_it_would_do_and_does_nothing(root: Path, empty: dict[str, Path], tmp_path: Path):
    before = tree(tmp_path)
    said = installed(empty[FIRST], "--root", root, "--dry-run")
    assert f"would: mv -T {root}/opt/splitslam/.current {root}/opt/splitslam/current" in said
    (root / "opt/splitslam" / FIRST / "installed").unlink()  # an installation that was cut off
    said = installed(empty[FIRST], "--root", root, "--wheelhouse", tmp_path, "--dry-run")
    assert f"would: rm -rf {root}/opt/splitslam/{FIRST}\n" in said
    assert "-m venv" in said
    assert f"--no-index --find-links {tmp_path}" in said
    assert tree(tmp_path).keys() == before.keys() - {f"{root}/opt/splitslam/{FIRST}/installed"}


def test_a_version_that_does_not_start_is_taken_back(root: Path, empty: dict[str, Path], tmp_path: Path):
    calls = tmp_path / "calls"
    bad = tmp_path / "bad"  # the first restart fails
    fails = f'[ "$1" != restart ] || [ ! -e {bad} ] || {{ rm {bad}; exit 1; }}'
    fake = program(tmp_path / "systemctl", f'echo "$@" >> {calls}\n{fails}')
    bad.touch()
    done = install(empty[FIRST], "--root", root, "--no-kernels", SPLITSLAM_SYSTEMCTL=str(fake))
    assert done.returncode == 1
    assert done.stderr == f"install.sh: {FIRST} does not start, {SECOND} is back: journalctl -u edge-agent\n"
    assert current(root) == SECOND
    assert [call.split()[0] for call in calls.read_text().splitlines()] == [
        *("enable", "daemon-reload", "is-active", "restart"),
        *("daemon-reload", "restart"),
    ]
    install(empty[FIRST], "--root", root, "--no-kernels", SPLITSLAM_SYSTEMCTL=str(fake))
    assert current(root) == FIRST


def test_older_versions_go_and_current_and_previous_stay(root: Path, empty: dict[str, Path]):
    versions = root / "opt/splitslam"
    for old in ("0.0.8", "0.0.9", "0.0.10"):
        shutil.copytree(versions / FIRST, versions / old, symlinks=True)
    kernels = root / "var/cache/splitslam/0.0.8"
    kernels.mkdir(parents=True)
    installed(empty[FIRST], "--root", root, "--no-kernels")
    assert {path.parent.name for path in versions.glob("*/installed")} == {*empty, "0.0.10", "current", "previous"}
    assert not kernels.exists()


def test_what_cannot_be_done_is_one_line_and_changes_nothing(root: Path, empty: dict[str, Path], tmp_path: Path):
    whole = empty[FIRST].read_bytes()
    files = {"good": empty[FIRST]}
    named = {"cut": "splitslam-0.1.2-py3-none-any.whl", "other": empty[FIRST].name, "name": "splitslam.zip"}
    for kind, name in named.items():
        files[kind] = tmp_path / kind / name
        files[kind].parent.mkdir()
    files["cut"].write_bytes(whole[: len(whole) // 2])
    files["other"].write_bytes(b" " + whole)
    files["name"].write_bytes(whole)
    before = tree(root / "opt")
    for arguments, line in REFUSED:
        done = install(*(argument.format(**files) for argument in arguments), "--root", root)
        assert (done.returncode, done.stderr) == (2, f"install.sh: {line.format(**files)}\n")
        assert tree(root / "opt") == before, line
    (root / "opt/splitslam/previous").unlink()
    done = install("--rollback", "--root", root)
    assert done.stderr == f"install.sh: --rollback: there is no version before {SECOND}\n"
    (root / "opt/splitslam/current").unlink()
    done = install("--rollback", "--root", root)
    assert (done.returncode, done.stderr) == (
        2,
        f"install.sh: --rollback: no version is installed in {root}/opt/splitslam\n",
    )


REFUSED = [
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
]


def test_a_machine_that_does_not_fit_is_refused(empty: dict[str, Path], tmp_path: Path):
    root = tmp_path / "bare"
    root.mkdir()
    lines = {
        "uname": ("armv7l", r"armv7l: expected x86_64 or aarch64"),
        "df": ("Filesystem x\\nx 0 0 300 0%", r"\S+: 300 MB are free, expected \d+ MB"),
    }
    for name, (prints, line) in lines.items():
        (tmp_path / name).mkdir()
        program(tmp_path / name / name, f"printf '%b\\n' '{prints}'")
        done = install(empty[FIRST], "--root", root, path=tmp_path / name)
        assert done.returncode in (1, 2)
        assert re.fullmatch(rf"install\.sh: {line}\n", done.stderr), done.stderr
        assert not list(root.glob("opt/splitslam/*/installed"))
        assert not (root / "opt/splitslam/current").exists()


def test_a_wheelhouse_without_a_package_is_said_by_name(empty: dict[str, Path], tmp_path: Path):
    root = tmp_path / "bare"
    root.mkdir()
    done = install(empty[FIRST], "--root", root, "--wheelhouse", tmp_path / "wheels")
    assert done.returncode == 1
    assert re.match(r"install\.sh: pip: ERROR: .*gtsam", done.stderr), done.stderr
    assert done.stderr.count("\n") == 1
    assert not (root / "opt/splitslam/current").exists()
    assert not (root / "opt/splitslam" / FIRST / "installed").exists()


def test_a_configuration_that_the_new_version_does_not_take_is_said_before_anything_is_switched(
    root: Path, empty: dict[str, Path]
):
    config = root / "etc/splitslam/edge.yaml"
    config.write_text(config.read_text() + "uplnik: {}\n")
    done = install(empty[FIRST], "--root", root, "--no-kernels")
    assert done.returncode == 2
    assert done.stderr == f"install.sh: {FIRST}: {config}: uplnik: unknown key; nearest known: uplink\n"
    assert current(root) == SECOND
