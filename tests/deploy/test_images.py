"""The images' recipes: nothing builds them here, so each of their parts is held against what it says."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import llvmlite.binding as llvm
import pytest

from tests.conftest import ROOT
from tests.deploy.dockerfile import Dockerfile

IMAGES = [Dockerfile(path) for path in sorted((ROOT / "deploy" / "docker").glob("*.Dockerfile"))]
EACH = pytest.mark.parametrize("image", IMAGES, ids=lambda image: image.path.stem)
BIN = Path(sys.executable).parent


def test_there_is_one_for_each_side() -> None:
    assert [image.path.stem for image in IMAGES] == ["edge_agent", "map_service"]


@EACH
def test_hadolint_has_nothing_to_say(image: Dockerfile) -> None:
    said = subprocess.run((BIN / "hadolint", image.path), capture_output=True, text=True, timeout=60)
    assert (said.returncode, said.stdout) == (0, "")


def test_hadolint_would_say_it(tmp_path: Path) -> None:
    wrong = tmp_path / "Dockerfile"
    wrong.write_text(IMAGES[0].path.read_text().replace(":3.12.11-slim-bookworm", ":latest") + "RUN cd /tmp\n")
    assert "DL3003" in subprocess.run((BIN / "hadolint", wrong), capture_output=True, text=True, timeout=60).stdout


@EACH
def test_what_is_copied_is_there_and_is_sent_to_the_builder(image: Dockerfile) -> None:
    allowed = [line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line.startswith("!")]
    for source in image.copied():
        assert (ROOT / source).exists(), source
        assert any(source == rule or rule.startswith(f"{source}/") or source.startswith(rule) for rule in allowed)


@EACH
def test_every_package_of_the_wheel_is_copied(image: Dockerfile) -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    packages = {
        name.rstrip("*").partition(".")[0] for name in project["tool"]["setuptools"]["packages"]["find"]["include"]
    }
    assert packages <= set(image.copied())
    links = [path for path in (ROOT / "splitslam").rglob("*") if path.is_symlink()]
    targets = {str(link.resolve().relative_to(ROOT)) for link in links}
    assert all(any(target.startswith(source) for source in image.copied()) for target in targets), targets


@EACH
def test_the_base_is_of_one_version_and_the_packages_are_those_of_the_lock(image: Dockerfile) -> None:
    (base,) = [rest for name, rest in image.instructions if name == "ARG" and rest.startswith("PYTHON=")]
    version = base.removeprefix("PYTHON=python:").partition("-")[0]
    assert len(version.split(".")) == 3
    assert base.endswith("-slim-bookworm")
    assert image.environment("wheel")["PIP_CONSTRAINT"] == "/tmp/constraints.txt"
    installs = [rest for name, rest in image.instructions if name == "RUN" and "bin/pip install" in rest]
    extra = {"edge_agent": "[edge]", "map_service": "[server]"}[image.path.stem]
    assert len(installs) == 1
    assert extra in installs[0]


@EACH
def test_it_runs_as_nobody_special_and_stops_by_sigterm(image: Dockerfile) -> None:
    assert all(int(part) >= 10_000 for part in image.all("USER")[-1].split(":"))
    assert image.all("STOPSIGNAL") == ["SIGTERM"]
    (labels,) = image.all("LABEL")
    assert labels.count("org.opencontainers.image.") == 4
    assert image.final.index(("USER", image.all("USER")[-1])) > max(
        i for i, (name, _) in enumerate(image.final) if name in ("RUN", "COPY")
    ), "what is built belongs to root"


@EACH
def test_its_commands_are_ones(image: Dockerfile) -> None:
    program = image.path.stem.replace("_", "-")
    entry, *words = image.command("ENTRYPOINT")
    assert (entry, words) == ("/opt/splitslam/entrypoint", [program])
    for command in ([*words, *image.command("CMD")], image.command("HEALTHCHECK")):
        known = subprocess.run((BIN / command[0], *command[1:2], "--help"), capture_output=True, text=True, timeout=60)
        assert command[0] == program
        assert known.returncode == 0, known.stderr
        assert all(word in known.stdout for word in command[2:] if word.startswith("--"))


@EACH
def test_the_health_check_says_no_while_nothing_runs(image: Dockerfile) -> None:
    command = image.command("HEALTHCHECK")
    where = ("--server", "127.0.0.1:1") if command[0] == "map-service" else ("--metrics", "127.0.0.1:1")
    asked = subprocess.run((BIN / command[0], *command[1:], *where), capture_output=True, text=True, timeout=60)
    assert asked.returncode == 1
    assert "127.0.0.1:1" in asked.stderr
    assert asked.stderr.count("\n") == 1


@EACH
def test_the_kinds_of_cpu_that_kernels_are_compiled_for_exist(image: Dockerfile) -> None:
    for machine, triple in (("amd64", "x86_64-unknown-linux-gnu"), ("arm64", "aarch64-unknown-linux-gnu")):
        said = image.environment(f"cpu-{machine}")
        assert said["NUMBA_CPU_FEATURES"] == "", "the builder's own would be added"
        if machine == "arm64":
            assert said["NUMBA_CPU_NAME"] == "generic"
            continue
        llvm.initialize_native_target()
        llvm.initialize_native_asmprinter()
        target = llvm.Target.from_triple(triple)
        assert target.create_target_machine(cpu=said["NUMBA_CPU_NAME"], features="").triple == triple


@EACH
def test_kernels_that_were_compiled_at_build_time_are_found_by_a_container_that_can_write_to_tmp_only(
    image: Dockerfile, tmp_path: Path
) -> None:
    """One small kernel, by the entry point and with the image's settings; on another CPU it is compiled anew."""
    own = image.environment()
    built, scratch = tmp_path / "kernels", tmp_path / "tmp" / "kernels"
    settings = {**image.environment("cpu-amd64"), "SPLITSLAM_KERNELS": str(built)}
    assert (own["SPLITSLAM_KERNELS"], own["NUMBA_CACHE_DIR"]) == ("/opt/splitslam/kernels", "/tmp/kernels")
    if os.uname().machine != "x86_64":
        settings |= image.environment("cpu-arm64")

    def compiled(*command: str | Path, **more: str) -> int:
        run = (
            "import json, numpy\n"
            "from splitslam.compile_count import counted\n"
            "with counted() as report:\n"
            "    from splitslam._motion_kernels import vector_of\n"
            "    vector_of(numpy.eye(3), numpy.empty(3))\n"
            "print(json.dumps(report.as_dict()))"
        )
        done = subprocess.run(
            (*command, sys.executable, "-c", run),
            env={**os.environ, **settings, **more}, cwd=ROOT, capture_output=True, text=True, timeout=120,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)["compiled"]

    entry = ROOT / "deploy" / "docker" / "entrypoint.sh"
    assert compiled(NUMBA_CACHE_DIR=str(built)) > 0
    built.chmod(0o555)
    assert compiled(entry, NUMBA_CACHE_DIR=str(scratch)) == 0
    assert compiled(entry, NUMBA_CACHE_DIR=str(scratch), NUMBA_CPU_NAME="nocona") > 0


def test_the_entry_point_gives_its_place_to_the_program(tmp_path: Path) -> None:
    """Else SIGTERM ends the shell, and the service is killed without handing its sessions over."""
    (tmp_path / "kernels").mkdir()
    variables = {"SPLITSLAM_KERNELS": str(tmp_path / "kernels"), "NUMBA_CACHE_DIR": str(tmp_path / "scratch")}
    entry = ROOT / "deploy" / "docker" / "entrypoint.sh"
    assert os.access(entry, os.X_OK)
    shown = subprocess.Popen((entry, "sleep", "30"), env={**os.environ, **variables})
    try:
        deadline = 500
        while (name := Path(f"/proc/{shown.pid}/comm").read_text().strip()) != "sleep" and deadline:
            deadline -= 1
            subprocess.run(("sleep", "0.01"))
        assert name == "sleep"
    finally:
        shown.kill()
        shown.wait()
