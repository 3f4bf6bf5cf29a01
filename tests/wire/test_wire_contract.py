"""The generated code carries every field, with the oldest protobuf that is allowed and with the newest."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from google.protobuf import __version__ as protobuf_version
from google.protobuf.message import DecodeError, Message
from packaging.requirements import Requirement
from packaging.version import Version

from splitslam.wire import session_pb2
from tests.conftest import ROOT
from tests.once import made_once
from tests.wire import samples

OLDEST = {"protobuf": "5.26.1", "grpcio": "1.64.0"}
MESSAGES = list(samples.messages())


def _title(message: Message) -> str:
    chosen = [message.WhichOneof(oneof.name) or "" for oneof in message.DESCRIPTOR.oneofs]
    return ".".join([message.DESCRIPTOR.name, *chosen])


@pytest.mark.parametrize("message", MESSAGES, ids=_title)
def test_every_field_of_a_message_comes_back(message: Message) -> None:
    back = type(message).FromString(message.SerializeToString())
    fields = {field.name for field in message.DESCRIPTOR.fields if field.containing_oneof is None}
    chosen = {message.WhichOneof(oneof.name) for oneof in message.DESCRIPTOR.oneofs}
    assert {field.name for field, _ in back.ListFields()} == fields | chosen
    assert back == message


def test_the_samples_cover_every_message_of_the_contract() -> None:
    declared = {
        line.split()[1]
        for path in (ROOT / "proto" / "splitslam" / "v1").glob("*.proto")
        for line in path.read_text().splitlines()
        if line.startswith("message ")
    }
    assert {message.DESCRIPTOR.name for message in MESSAGES} == declared


def test_a_field_of_a_later_version_is_kept_and_a_cut_message_is_refused() -> None:
    frame = next(message for message in MESSAGES if message.DESCRIPTOR.name == "Frame")
    wire = frame.SerializeToString()
    later = wire + bytes([0xFA, 0x3F, 3]) + b"new"  # field 1023, length-delimited
    assert session_pb2.Frame.FromString(later).SerializeToString() == later
    with pytest.raises(DecodeError):
        session_pb2.Frame.FromString(wire[:-1])


def _install_oldest() -> Path:
    """A folder with the oldest protobuf and grpcio."""

    def install(folder: Path) -> None:
        pins = [f"{name}=={version}" for name, version in OLDEST.items()]
        command = [sys.executable, "-m", "pip", "install", "-qq", "--only-binary=:all:", "--target", str(folder)]
        installed = subprocess.run([*command, *pins], capture_output=True, text=True, timeout=200)
        assert installed.returncode == 0, installed.stderr[-2000:]

    name = f"py{sys.version_info[0]}{sys.version_info[1]}-protobuf-{OLDEST['protobuf']}"
    return made_once(ROOT / ".venv-compat" / name, install)


def test_the_oldest_allowed_protobuf_writes_the_same_bytes_as_the_installed_one() -> None:
    path = os.pathsep.join([str(_install_oldest()), str(ROOT)])
    # -S: only that folder, not this environment's packages. The one warning is protobuf 5's own on Python 3.12.
    warnings = ["-W", "error", "-W", "ignore:Type google._upb"]
    command = [sys.executable, "-S", *warnings, str(ROOT / "tests" / "wire" / "samples.py")]
    done = subprocess.run(command, env={"PYTHONPATH": path}, capture_output=True, text=True, timeout=100)
    assert done.returncode == 0, done.stderr[-3000:]
    answer = json.loads(done.stdout)
    assert answer["protobuf"] == OLDEST["protobuf"]
    here: dict[str, list[str]] = {}
    for message in MESSAGES:
        here.setdefault(message.DESCRIPTOR.full_name, []).append(message.SerializeToString(deterministic=True).hex())
    assert answer["messages"] == here


def test_the_installed_protobuf_is_of_the_newest_major_version_that_is_allowed() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    allowed = next(r.specifier for r in map(Requirement, project["dependencies"]) if r.name == "protobuf")
    major = Version(protobuf_version).major
    assert protobuf_version in allowed
    assert f"{major + 1}.0" not in allowed
    assert OLDEST["protobuf"] in allowed
    assert "5.25.9" not in allowed
