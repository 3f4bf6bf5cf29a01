"""docs/robot.md, typed from top to bottom below a folder: every command does what it is there for."""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sysconfig
import zipfile
from pathlib import Path

from edge_agent.config import AgentConfig
from splitslam.config import load
from tests.conftest import ROOT
from tests.docs.commands import FENCE
from tests.systemd.tools import debian
from tests.systemd.unit import UNITS
from tests.systemd.wheels import build_wheel

GUIDE = (ROOT / "docs" / "robot.md").read_text()
FIRST, SECOND = "0.2.0", "0.2.1"
# What needs a network: the wheel is made by the test, its packages are this environment's.
NOT_TYPED = (".venv/bin/python -m pip wheel ", ".venv/bin/python -m pip download ")
SYSTEMCTL = """#!/usr/bin/env bash
echo "$@" >> {calls}
case $1 in
    daemon-reload) ;;
    is-active | start | stop | restart | reload | enable | status | reset-failed) [[ ${{@: -1}} == edge-agent ]] ;;
    show) exit 1 ;;
    *) exit 64 ;;
esac
"""


def typed() -> list[str]:
    return [line for block in FENCE.findall(GUIDE) for line in block.splitlines() if line.strip()]


def programs(folder: Path) -> Path:
    """Those of a machine with systemd and an operator, as far as this one has none."""
    made = {
        "sudo": '#!/bin/sh\nexec "$@"\n',
        "editor": "#!/bin/sh\ntest -w $1\n",
        "systemctl": SYSTEMCTL.format(calls=folder / "calls"),
        "journalctl": '#!/bin/sh\n[ "$1" = --unit ] && [ "$2" = edge-agent ]\n',
    }
    (folder / "bin").mkdir()
    for name, text in made.items():
        (folder / "bin" / name).write_text(text)
        (folder / "bin" / name).chmod(0o755)
    return folder / "bin"


def below(line: str, root: Path, folder: Path) -> str:
    """The line with the machine's folders below `root`, its group ours, and what an option of the script stands for."""
    line = line.replace("/tmp/", f"{folder}/").replace("-g splitslam", f"-g {os.getgid()}")
    line = re.sub(r"(?<![\w.])/(etc|opt|var|run)/", rf"{root}/\1/", line)
    line = line.replace("--wheelhouse dist", f"--packages-from {sysconfig.get_path('purelib')} --no-kernels")
    line = line.replace("install.sh ", f"install.sh --root {root} ")
    edge = f"--edge {root}/var/lib/splitslam --config {root}/etc/splitslam/edge.yaml"
    return line.replace("splitslam diagnose", f"splitslam diagnose {edge}")


def test_every_command_of_the_guide_works_in_its_order(tmp_path: Path):
    root, folder = tmp_path / "root", tmp_path / "work"
    (folder / "dist").mkdir(parents=True)
    root.mkdir()
    path = programs(tmp_path)
    for version in (FIRST, SECOND):
        build_wheel(folder / "dist", version)
    (folder / "deploy").symlink_to(ROOT / "deploy")
    for name in ("robot.crt", "robot.key", "ca.crt", "robot.yaml"):
        (folder / name).write_text("robot: {id: rover-7}\n" if name == "robot.yaml" else "a key\n")
    environment = {
        "PATH": f"{path}:{os.environ['PATH']}",
        "SPLITSLAM_SYSTEMCTL": str(path / "systemctl"),
        "LANG": "C.UTF-8",
    }
    versions = []
    for line in typed():
        if line.startswith(NOT_TYPED):
            continue
        command = below(line, root, folder)
        done = subprocess.run(
            ["bash", "-euc", command], cwd=folder, env=environment, capture_output=True, text=True, timeout=200
        )
        assert done.returncode == 0, f"{line}\n{command}\n{done.stdout}{done.stderr}"
        if "install.sh" in line and "--dry-run" not in line:
            versions.append(os.readlink(root / "opt/splitslam/current"))

    assert versions == [FIRST, SECOND, FIRST]
    load(AgentConfig, root / "etc/splitslam/edge.yaml")
    assert (root / "etc/systemd/system/edge-agent.service").read_text() == (UNITS / "edge-agent.service").read_text()
    assert (root / "etc/systemd/system/edge-agent.service.d/realtime.conf").is_file()
    assert (root / "etc/splitslam/tls/robot.key").stat().st_mode & 0o777 == 0o640
    calls = [line.split()[0] for line in (tmp_path / "calls").read_text().splitlines()]
    assert {"enable", "start", "status", "reload", "restart", "daemon-reload"} <= set(calls)
    with zipfile.ZipFile(folder / "robot.zip") as bundle:
        found = {check["name"]: check["verdict"] for check in json.loads(bundle.read("summary.json"))["edge"]}
    assert found["agent"] == "warn"  # it was never started here
    assert found["configuration"] == "ok"


def test_the_verbs_that_the_guide_uses_are_systemds():
    known = subprocess.run([debian("systemctl", "systemd"), "--help"], capture_output=True, text=True).stdout
    verbs = {shlex.split(line)[shlex.split(line).index("systemctl") + 1] for line in typed() if "systemctl " in line}
    assert {"start", "restart", "reload", "status", "daemon-reload"} <= verbs
    assert not [verb for verb in verbs if not re.search(rf"^  {verb}\b", known, re.MULTILINE)]


def test_what_is_not_typed_is_what_needs_a_network():
    assert len([line for line in typed() if line.startswith(NOT_TYPED)]) == len(NOT_TYPED)
