"""What every release so far has written is read by this one: frames, messages, spools, stores."""

from __future__ import annotations

import importlib
import json
import lzma
import shutil
import sqlite3
import subprocess
import zipfile
from pathlib import Path

import numpy as np
import pytest

from edge_agent.spool import SpoolFolder
from map_service.catalog import Catalog
from map_service.hello import read_hello
from map_service.integrity import Seen, findings
from map_service.migrations import VERSION as SCHEMA
from map_service.migrations import migrate
from map_service.store import Store
from splitslam import __version__, codec
from splitslam.se3 import quat_from_matrix
from splitslam.wire import session_pb2 as pb
from tests import tolerances as bars
from tests.versions import previous
from tests.versions.make_golden import GOLDEN, SPOOL_BYTES, arrays, decoded
from tests.versions.trees import tree_id
from tests.wire import samples

RELEASES = sorted(path.name for path in GOLDEN.iterdir())
EACH = pytest.mark.parametrize("release", RELEASES)
CODECS = {"0.1.0": 1, "0.2.0": 2}
SCHEMAS = {"0.1.0": 1, "0.2.0": 2}


def frame_of(release: str, name: str) -> pb.Frame:
    return pb.Frame.FromString((GOLDEN / release / f"{name}.bin").read_bytes())


def hello_of(release: str) -> pb.Hello:
    return pb.Hello.FromString((GOLDEN / release / "hello.bin").read_bytes())


def test_there_is_one_of_this_release_and_of_the_one_before() -> None:
    assert {__version__, previous.VERSION} <= set(RELEASES)
    assert {CODECS[release] for release in RELEASES} == set(range(1, codec.CODEC_VERSION + 1)), "a codec has no frame"


@EACH
@pytest.mark.parametrize("name", ["dense", "sparse"])
def test_a_frame_decodes_to_what_it_was(release: str, name: str) -> None:
    frame, hello = frame_of(release, name), hello_of(release)
    assert frame.codec_version == frame.payload[0] == CODECS[release]
    now = arrays(decoded(frame, hello))
    with np.load(GOLDEN / release / f"{name}.npz") as then:
        assert set(then) == set(now)
        for part in then:
            if now[part].dtype.kind == "f":  # another CPU may round differently
                np.testing.assert_allclose(now[part], then[part], rtol=1e-6, atol=bars.GOLDEN_M)
            else:
                np.testing.assert_array_equal(now[part], then[part])
    assert len(now["surfs_ring"]) > 100


def test_a_bit_that_is_not_as_it_was_is_seen() -> None:
    frame, hello = frame_of(__version__, "dense"), hello_of(__version__)
    frame.payload = frame.payload[:900] + bytes([frame.payload[900] ^ 1]) + frame.payload[901:]
    with pytest.raises(codec.DecodeError):
        decoded(frame, hello)


@EACH
def test_a_robot_of_a_release_is_served(release: str) -> None:
    hello = hello_of(release)
    assert hello.agent_version == release
    request = read_hello(hello, codec.CODEC_VERSION)
    assert (request.opening.robot_id, request.codec_version) == ("golden", CODECS[release])


@EACH
def test_every_message_of_a_release_is_read_and_nothing_of_it_is_lost(release: str) -> None:
    types = {}
    for module in samples.MODULES:
        wire = importlib.import_module(f"splitslam.wire.{module}_pb2")
        types |= {d.full_name: getattr(wire, d.name) for d in wire.DESCRIPTOR.message_types_by_name.values()}
    golden = json.loads((GOLDEN / release / "wire.json").read_text())
    for name, variants in golden.items():
        for wire in map(bytes.fromhex, variants):
            message = types[name].FromString(wire)
            assert message.SerializeToString(deterministic=True) == wire
            known = type(message)()
            known.CopyFrom(message)
            known.DiscardUnknownFields()
            assert known == message, f"{name} has a field that is not known any more"


@EACH
def test_a_store_of_a_release_is_whole_after_the_way_here_and_back(release: str, tmp_path: Path) -> None:
    file = tmp_path / "map.db"
    with sqlite3.connect(file) as database:
        database.executescript(lzma.decompress((GOLDEN / release / "store.sql.xz").read_bytes()).decode())
        (found,) = database.execute("SELECT value FROM meta WHERE key = 'schema_version'").fetchone()
    assert int(found) == SCHEMAS[release]
    poses = json.loads((GOLDEN / release / "store.json").read_text())
    for _ in range(2):
        store = Store(f"sqlite:///{file}")  # migrates
        catalog = Catalog(store)
        sessions = {row.robot_id: row for row in catalog.sessions()}
        assert {name: bool(row.finished) for name, row in sessions.items()} == {"finished": True, "unfinished": False}
        assert list(findings(store, Seen())) == []
        for name, row in sessions.items():
            stored = [(seq, stamp_ns, T) for page in catalog.trajectory(row.id) for seq, stamp_ns, T in page]
            assert [[seq, stamp_ns] for seq, stamp_ns, _ in stored] == [pose[:2] for pose in poses[name]]
            now = np.array([[*T[:3, 3], *quat_from_matrix(T[:3, :3])] for *_, T in stored])
            np.testing.assert_allclose(now, [pose[2:] for pose in poses[name]], atol=bars.SE3_ROUND_TRIP_M)
        back = migrate(store.engine, 1)  # what a service of 0.1.0 works with
        assert (back.before, back.after) == (SCHEMA, 1)
        store.close()


@pytest.mark.parametrize("release", [release for release in RELEASES if release != "0.1.0"])  # it had none
def test_a_spool_of_a_release_is_taken_over(release: str, tmp_path: Path) -> None:
    shutil.copytree(GOLDEN / release / "spool", tmp_path / "spool")
    spools = SpoolFolder(tmp_path / "spool", SPOOL_BYTES)
    (run,) = spools.others("another-run")
    assert run.hello == hello_of(release)
    assert run.dropped == {"buffer_full": 1}
    spool = spools.open(run)
    assert [head.seq for head in spool.recovered.heads] == [1, 2, 3, 4, 6, 7, 8, 9, 10], "5 was given up"
    assert (spool.recovered.durable_seq, spool.recovered.damaged, dict(spool.errors)) == (2, 0, {})
    first = spool.get(3)
    assert first is not None
    assert len(decoded(first, hello_of(release)).surfs) > 100
    spool.close()
    spools.close()


@pytest.mark.parametrize("package", previous.TREES)
def test_the_wheel_of_the_release_before_is_what_its_commit_says(package: str) -> None:
    """A clone need not have the history: the commit's own name for a folder follows from the files in it."""
    with zipfile.ZipFile(previous.WHEEL) as wheel:
        names = [name for name in wheel.namelist() if name.startswith(f"{package}/")]
        files = {name.removeprefix(f"{package}/"): wheel.read(name) for name in names}
    assert tree_id(files) == previous.TREES[package]


def test_a_folder_is_called_what_git_calls_it(tmp_path: Path) -> None:
    files = {"b": b"", "a.py": b"x = 1\n", "a/b/c.py": b"\0", "a/b.py": b"y\n", "a0": b"sorts behind the folder a"}
    for name, content in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(content)
    for command in ("init --quiet", "add --all", "write-tree"):
        done = subprocess.run(("git", *command.split()), cwd=tmp_path, capture_output=True, text=True, check=True)
    assert tree_id(files) == done.stdout.strip()
