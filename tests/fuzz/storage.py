"""Targets on disks: spool files of the robot, keyframe clouds and rows of the store, recordings of sensors."""

from __future__ import annotations

import contextlib
import sqlite3
from types import SimpleNamespace
from typing import Any

import numpy as np
from sqlalchemy import insert

from edge_agent.sources.cloud_decoder import CloudDecoder
from edge_agent.sources.raw import Gate
from edge_agent.sources.velodyne import PACKET_BYTES, VelodyneDecoder
from edge_agent.spool import Spool, SpoolFolder
from edge_agent.spool.record import Head, pack
from map_service import export, integrity, schema
from map_service.catalog import Catalog
from map_service.cloud import decode_cloud
from map_service.database import StoreError
from map_service.session_service import session_info
from map_service.store import Store
from splitslam import dense_cloud
from splitslam.errors import DataError, InputError
from splitslam.robot import Robot
from tests.codec.mutations import sealed
from tests.dense.made import cloud
from tests.fuzz.mutate import Rng, mutated
from tests.fuzz.target import Target, scratch
from tests.map_service.entries import OPENING, sound
from tests.map_service.fakes import made_cloud
from tests.map_service.harness import frame, hello, new_run
from tests.sources.test_velodyne_packets import DUAL, T0_NS, message, packet


def spool_files() -> Target:
    """What is read back must be what was written: a checksum stands over every frame."""
    folder, remove = scratch()
    bodies = {seq: frame(seq, bytes([seq]) * (10 * seq)).SerializeToString() for seq in range(1, 9)}
    records = [pack(Head(seq, 1000 * seq, seq % 2 == 0, seq - 1, len(body)), body) for seq, body in bodies.items()]
    run = folder / new_run()
    run.mkdir()
    file = run / "00000001.seg"
    greeting = hello(run.name).SerializeToString()

    def feed(data: bytes) -> None:
        run.mkdir(exist_ok=True)
        for stale in run.iterdir():
            stale.unlink()
        file.write_bytes(data)
        (run / "hello").write_bytes(mutated([greeting], np.random.default_rng(len(data))))
        (run / "dropped").write_bytes(data[:40])
        spool = Spool(run, 1 << 20)
        try:
            for seq in [head.seq for head in spool.recovered.heads]:
                read = spool.get(seq)
                assert read is not None
                assert read.SerializeToString() == bodies[read.seq], "a frame that nobody wrote"
            assert spool.put(frame(100), 0)
        finally:
            spool.close()
        whole = SpoolFolder(folder, 1 << 20)
        try:
            for other in whole.others(""):
                _ = (other.hello, other.dropped, other.said_bye)
        finally:
            whole.close()

    seeds = [b"".join(records), records[0], b"".join(records[::-1])]
    return Target("spool files", lambda rng: mutated(seeds, rng), feed, (), remove)


def clouds() -> Target:
    seeds = [made_cloud(), made_cloud()[:10]]

    def feed(data: bytes) -> None:
        points, intensity, is_corner = decode_cloud(data)
        assert len(points) == len(intensity) == len(is_corner)
        assert np.isfinite(points).all()

    return Target("keyframe clouds", lambda rng: mutated(seeds, rng), feed, (DataError,))


def dense_clouds() -> Target:
    """Whole scans as a service stores them, with a checksum that is right half of the time."""
    seeds = [cloud(points=40), cloud(points=0), cloud(points=300)]

    def make(rng: Rng) -> bytes:
        data = mutated(seeds, rng)
        return sealed(data[:-4]) if rng.random() < 0.5 else data

    def feed(data: bytes) -> None:
        head = dense_cloud.check(data)
        points, intensity = dense_cloud.decode(data)
        assert len(points) == len(intensity) == head.points
        assert np.isfinite(points).all()

    return Target("dense clouds", make, feed, (DataError,))


def store_rows() -> Target:
    """One cell of a sound store is not what was written: the check names it, and readers refuse it or go on."""
    folder, remove = scratch()
    path = folder / "map.db"
    store = Store(f"sqlite:///{path}")
    opened = store.open_session(OPENING)
    store.commit(opened.key, 1, sound())
    with store.writing() as connection:
        row = {"session": opened.key, "keyframe": 0, "cloud": cloud(points=40)}
        connection.execute(insert(schema.dense_clouds).values(row))
    store.close()
    whole = path.read_bytes()
    with sqlite3.connect(path) as db:
        tables = [name for (name,) in db.execute("select name from sqlite_master where type = 'table'")]
        cells = [
            (table, column[1], row, value)
            for table in tables
            for column in db.execute(f"pragma table_info({table})").fetchall()
            for row, value in db.execute(f"select rowid, {column[1]} from {table}").fetchall()
            if isinstance(value, (bytes, str)) and value and table not in ("schema", "alembic_version")
        ]
    db.close()

    def make(rng: Rng) -> tuple[str, str, int, Any]:
        table, column, row, value = cells[rng.integers(len(cells))]
        new = mutated([value if isinstance(value, bytes) else value.encode()], rng)
        return table, column, row, new if isinstance(value, bytes) else new.decode("latin-1")

    def feed(cell: tuple[str, str, int, Any]) -> None:
        table, column, row, value = cell
        path.write_bytes(whole)
        damaged = sqlite3.connect(path)
        with damaged:
            damaged.execute(f"update {table} set {column} = ? where rowid = ?", (value, row))
        damaged.close()
        damaged_store = Store(f"sqlite:///{path}")
        try:
            _read_all(damaged_store)
        finally:
            damaged_store.close()

    return Target("store rows", make, feed, (InputError,), remove)


def _read_all(store: Store) -> None:
    list(integrity.findings(store, integrity.Seen()))
    catalog = Catalog(store)
    for row in catalog.sessions():
        _read_session(store, catalog, row)


def _read_session(store: Store, catalog: Catalog, row: Any) -> None:
    for reader in (
        lambda: session_info(row),
        lambda: [list(page) for page in catalog.trajectory(row.id)],
        lambda: list(export.map_pieces(catalog.keyframes(row.id, dense=True), 0.1)),
        lambda: store.load(row.id),
        lambda: store.answers(row.id, last=10),
    ):
        with contextlib.suppress(DataError, StoreError):
            reader()


def packets() -> Target:
    """VelodyneScan messages: the sensor's own packets."""
    decoders = {model: VelodyneDecoder(model) for model in ("vlp16", "hdl32", "hdl64")}
    seeds = [packet(1000 * n, 400 * n) for n in range(4)] + [packet(5, mode=DUAL)]

    def make(rng: Rng) -> tuple[str, Any]:
        count = int(rng.integers(1, 6))
        data = [mutated(seeds, rng) if rng.random() < 0.5 else seeds[n % 4] for n in range(count)]
        if rng.random() < 0.9:  # else of any length
            data = [(d + bytes(PACKET_BYTES))[:PACKET_BYTES] for d in data]
        stamps = [
            T0_NS + 1_327_000 * n + int(rng.integers(-(10**9), 10**9) * (rng.random() < 0.1)) for n in range(count)
        ]
        return list(decoders)[rng.integers(3)], message(data, stamps)

    def feed(given: tuple[str, Any]) -> None:
        model, scan = given
        decoder = decoders[model]
        decoder.check(scan)
        _gated(decoder(scan))

    return Target("packets", make, feed, (DataError, InputError))


def point_clouds() -> Target:
    """PointCloud2 messages of any layout."""
    fields = [("x", 0, 7), ("y", 4, 7), ("z", 8, 7), ("intensity", 12, 7), ("ring", 16, 4), ("time", 18, 7)]
    points = np.random.default_rng(0).normal(0, 10, (64, 3)).astype(np.float32)
    table = np.zeros((64, 22), np.uint8)
    table[:, :12] = points.view(np.uint8).reshape(64, 12)
    table[:, 18:] = np.linspace(0, 0.1, 64, dtype=np.float32).view(np.uint8).reshape(64, 4)
    numbers = (0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 22, 63, 65, 255, 1 << 16, (1 << 31) - 1, (1 << 32) - 1)

    def any_of(rng: Rng, usual: int) -> int:
        return usual if rng.random() < 0.85 else int(rng.choice(numbers))

    def make(rng: Rng) -> Any:
        data = table.tobytes() if rng.random() < 0.5 else mutated([table.tobytes()], rng)
        stamp = SimpleNamespace(sec=any_of(rng, 1_700_000_000), nanosec=any_of(rng, 5))
        chosen = [f for f in fields if rng.random() < 0.95] + ([fields[rng.integers(6)]] if rng.random() < 0.1 else [])
        return SimpleNamespace(
            header=SimpleNamespace(stamp=stamp),
            height=any_of(rng, 1),
            width=any_of(rng, 64),
            point_step=any_of(rng, 22),
            row_step=any_of(rng, 22 * 64),
            is_bigendian=bool(rng.random() < 0.1),
            fields=[
                SimpleNamespace(name=n, offset=any_of(rng, o), datatype=any_of(rng, d), count=any_of(rng, 1))
                for n, o, d in chosen
            ],
            data=np.frombuffer(data, np.uint8),
        )

    def feed(scans: list[Any]) -> None:
        """Of one stream: what the first one means is held to."""
        decoder = CloudDecoder(Robot().lidar)
        decoder.beam_elevations_rad = np.linspace(-0.2, 0.2, 16, dtype=np.float32)
        for scan in scans[:-1]:
            with contextlib.suppress(DataError, InputError):
                decoder(scan)
        _gated(decoder(scans[-1]))

    return Target("point clouds", lambda rng: [make(rng) for _ in range(3)], feed, (DataError, InputError))


def _gated(raw: Any) -> None:
    from collections import Counter

    scan = Gate(Robot(), Counter())(raw)
    assert np.isfinite(scan.points_lidar).all()
    assert scan.ring.max() < Robot().lidar.rings
    assert scan.t_offset_ns.min() >= 0
