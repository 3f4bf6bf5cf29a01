"""The edge runs without the server's packages and the other way round; `--help` needs neither."""

from __future__ import annotations

import ast
import importlib.metadata
import json
import subprocess
import sys
import tomllib
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from tests.conftest import ROOT
from tests.packaging.probe import canonical, owners

# Packages that some machine has and no extra can promise; importing them is guarded where it happens.
OPTIONAL = {"pynq", "ouster"}


@dataclass(frozen=True)
class Side:
    name: str
    packages: tuple[str, ...]
    extra: str | None
    never: tuple[str, ...]
    more: str | None = None  # another extra
    without: str = ""  # a package inside that needs more, and is a side of its own


EDGE = Side(
    "edge",
    ("edge_agent", "fpga_overlay.golden", "fpga_overlay.driver"),
    "edge",
    ("map_service", "sqlalchemy", "small_gicp", "scipy", "gtsam", "grpc_health", "grpc_reflection", "matplotlib"),
    without="edge_agent.ros.dds",
)
EDGE_IN_ROS2 = Side("edge in ROS 2", ("edge_agent.ros.dds",), EDGE.extra, EDGE.never, more="ros2")
SERVER = Side("server", ("map_service",), "server", ("edge_agent", "rosbags", "velodyne_decoder", "matplotlib"))
SHARED = Side(
    "shared",
    (
        "splitslam.wire",
        "splitslam.scan",
        "splitslam.features",
        "splitslam.se3",
        "splitslam.codec",
        "splitslam.robot",
        "splitslam.registration",
    ),
    None,
    ("edge_agent", "map_service", "sqlalchemy", "small_gicp", "scipy", "rosbags", "velodyne_decoder", "matplotlib"),
)
COMMANDS = Side("commands", ("splitslam.cli",), None, (*SHARED.never, "gtsam", "numba"))


def _project() -> dict:
    return tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def _closure(roots: list[str]) -> set[str]:
    """Canonical names of all distributions that installing `roots` brings on this machine."""
    found: set[str] = set()
    queue = [Requirement(text) for text in roots]
    while queue:
        requirement = queue.pop()
        if requirement.marker and not any(
            requirement.marker.evaluate({"extra": extra}) for extra in (*requirement.extras, "")
        ):
            continue
        name = canonical(requirement.name)
        if name in found:
            continue
        found.add(name)
        extras = (*requirement.extras, "")
        for text in importlib.metadata.requires(requirement.name) or []:
            child = Requirement(text)
            if child.marker is None or any(child.marker.evaluate({"extra": extra}) for extra in extras):
                child.marker = None
                queue.append(child)
    return found


@cache
def _allowed(*extras: str | None) -> frozenset[str]:
    project = _project()
    roots = list(project["dependencies"])
    for extra in filter(None, extras):
        roots += project["optional-dependencies"][extra]
    return frozenset({*_closure(roots), "splitslam"})


@cache
def _probe(side: Side) -> tuple[tuple[str, ...], tuple[str, ...]]:
    allowed = sorted(_allowed(side.extra, side.more))
    request = {"packages": side.packages, "without": side.without, "allowed": allowed}
    command = [sys.executable, str(Path(__file__).with_name("probe.py")), json.dumps(request)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, timeout=200)
    assert done.returncode == 0, f"{side.name} does not import with its own packages only:\n{done.stderr[-3000:]}"
    answer = json.loads(done.stdout.splitlines()[-1])
    return tuple(answer["modules"]), tuple(answer["files"])


def _imported_names(path: Path) -> set[str]:
    """Top-level names of every import statement of a file, those inside functions too."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names.update(alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            names.add(node.module.partition(".")[0])
    return names


SIDES = pytest.mark.parametrize("side", [EDGE, EDGE_IN_ROS2, SERVER, SHARED, COMMANDS], ids=lambda side: side.name)


@SIDES
def test_a_side_imports_with_its_own_packages_only_and_loads_nothing_of_the_other(side: Side) -> None:
    modules, _ = _probe(side)
    loaded = {name.partition(".")[0] for name in modules}
    assert set(side.packages) <= set(modules)
    assert not loaded & set(side.never)


@pytest.mark.parametrize("side", [EDGE, EDGE_IN_ROS2, SERVER, SHARED], ids=lambda side: side.name)
def test_no_import_statement_of_a_side_even_inside_a_function_names_a_package_it_does_not_bring(side: Side) -> None:
    _, files = _probe(side)
    installed = owners()
    own = {"splitslam", *(package.partition(".")[0] for package in side.packages)}
    wrong = []
    for file in files:
        for name in sorted(_imported_names(Path(file)) - own - OPTIONAL - set(sys.stdlib_module_names)):
            if not installed.get(name, set()) & _allowed(side.extra, side.more):
                wrong.append(f"{Path(file).relative_to(ROOT)} imports {name}")
    assert not wrong


def test_the_versions_the_board_pins_are_allowed_on_the_edge() -> None:
    """PYNQ 4.0: grpcio 1.64.0 and numpy < 2; the generated code: protobuf 5.26."""
    project = _project()
    asked = {
        canonical(requirement.name): requirement.specifier
        for requirement in map(Requirement, project["dependencies"] + project["optional-dependencies"]["edge"])
    }
    for name, version in {"grpcio": "1.64.0", "numpy": "1.26.4", "protobuf": "5.26.1", "gtsam": "4.3.0"}.items():
        assert version in asked[name], f"{name} {asked[name]} shuts out {version}"
    assert "8.0.0" not in asked["protobuf"]
    assert "4.2.2" not in asked["gtsam"]
    assert "pynq" not in asked


def test_the_lock_names_every_direct_dependency_and_no_address() -> None:
    text = (ROOT / "requirements" / "lock.txt").read_text()
    locked = {canonical(line.partition("==")[0]) for line in text.splitlines() if "==" in line}
    project = _project()
    extras = {**project["optional-dependencies"], "": project["dependencies"]}
    peers = {canonical(Requirement(text).name) for text in extras.pop("peers")}
    direct = {canonical(Requirement(text).name) for group in extras.values() for text in group}
    assert direct <= locked
    assert not peers & locked, "the peers have an environment of their own"
    assert "://" not in text
    assert "--" not in text


def test_the_peers_environment_has_the_versions_that_the_extra_allows() -> None:
    lines = (ROOT / "requirements" / "bench.txt").read_text().splitlines()
    pins = dict(line.split("==") for line in lines if "==" in line)
    for asked in map(Requirement, _project()["optional-dependencies"]["peers"]):
        assert pins[asked.name] in asked.specifier
