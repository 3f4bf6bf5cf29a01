"""Is a store what it says it is? Every reference, number, blob and count, one line for each finding."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from google.protobuf.message import DecodeError as WireError
from sqlalchemy import Connection, Executable, Row, select

from map_service import migrations, schema
from map_service.cloud import decode_cloud
from map_service.history import unpack_poses
from map_service.store import Store
from splitslam import dense_cloud
from splitslam.errors import DataError
from splitslam.wire import pose_pb2 as pb

_POSE_BYTES = 56
_ROWS = 1000
_CLOUDS = 50
_DENSE_CLOUDS = 16
_UNIT = 1e-6


@dataclass(slots=True)
class Seen:
    """What has been looked at."""

    sessions: int = 0
    frames: int = 0
    keyframes: int = 0


def findings(store: Store, seen: Seen) -> Iterator[str]:
    """Lines, as they are found; `seen` is counted up. Raises StoreError."""
    if store.engine.dialect.name == "sqlite":
        yield from _sqlite(store)
    with store.reading() as connection:
        # holes of before the version that notes them are nobody's fault
        since_s = migrations.since(connection).get(2, 0.0)
        for row in connection.execute(select(schema.sessions).order_by(schema.sessions.c.id)).all():
            seen.sessions += 1
            for finding in _session(connection, row, since_s, seen):
                yield f"{row.session_id}: {finding}"


def _sqlite(store: Store) -> Iterator[str]:
    with store.reading() as connection:
        for (line,) in connection.exec_driver_sql("PRAGMA integrity_check"):
            if line != "ok":
                yield f"SQLite: {line}"
        for table, row, parent, _ in connection.exec_driver_sql("PRAGMA foreign_key_check"):
            yield f"SQLite: {table} row {row} refers to a row of {parent} that is not there"


def _session(connection: Connection, row: Row, since_s: float, seen: Seen) -> Iterator[str]:
    counts = {"frames": 0, "rejected": 0, "keyframes": 0, "loops": 0, "gnss_factors": 0}
    keyframes = yield from _keyframes(connection, row.id, counts)
    yield from _frames(connection, row, keyframes, row.opened_s >= since_s, counts)
    yield from _factors(connection, row.id, len(keyframes), counts)
    yield from _places(connection, row.id, keyframes)
    yield from _dense(connection, row.id, keyframes)
    yield from _versions(connection, row, len(keyframes))
    yield from _events(connection, row)
    for name, counted in counts.items():
        if counted != getattr(row, name):
            yield f"{counted} {name.replace('_', ' ')}, its row says {getattr(row, name)}"
    if row.tracker and (problem := _problem(json.loads, row.tracker)):
        yield f"tracker state: {problem}"
    seen.frames += counts["frames"]
    seen.keyframes += counts["keyframes"]


def _keyframes(connection: Connection, key: int, counts: dict[str, int]) -> Any:
    """Returns the keyframes that are there."""
    k, c = schema.keyframes, schema.clouds
    query = select(k.c.keyframe, k.c.pose_map_lidar).where(k.c.session == key).order_by(k.c.keyframe)
    poses: dict[int, bytes] = {row.keyframe: row.pose_map_lidar for row in _rows(connection, query)}
    counts["keyframes"] = len(poses)
    yield from _missing("keyframe", list(poses))
    for index, pose in poses.items():
        if problem := _pose_problem(pose):
            yield f"keyframe {index}: {problem}"
    without = set(poses)
    query = select(c.c.keyframe, c.c.cloud).where(c.c.session == key).order_by(c.c.keyframe)
    for index, cloud in _rows(connection, query, _CLOUDS):
        if index not in poses:
            yield f"cloud {index} belongs to no keyframe"
        elif problem := _problem(decode_cloud, cloud):
            yield f"keyframe {index}: {problem}"
        without.discard(index)
    for index in sorted(without):
        yield f"keyframe {index} has no cloud"
    return set(poses)


def _frames(
    connection: Connection, row: Row, keyframes: set[int], holes_noted: bool, counts: dict[str, int]
) -> Iterator[str]:
    f, h = schema.frames, schema.holes
    query = select(h.c.seq, h.c.follows_seq).where(h.c.session == row.id)
    holes: dict[int, int] = {hole.seq: hole.follows_seq for hole in _rows(connection, query)}
    last = 0
    query = select(f).where(f.c.session == row.id).order_by(f.c.seq)
    for frame in _rows(connection, query):
        if frame.seq != last + 1 and holes_noted and holes.get(frame.seq) != last:
            yield f"frames {last + 1} to {frame.seq - 1} are missing, and the robot did not say so"
        last = frame.seq
        if frame.rejected:
            counts["rejected"] += 1
            continue
        counts["frames"] += 1
        if frame.keyframe not in keyframes:
            yield f"frame {frame.seq} refers to keyframe {frame.keyframe}, which is not there"
        for name in ("pose_keyframe_lidar", "online_map_lidar", "online_map_odom"):
            if problem := _pose_problem(getattr(frame, name)):
                yield f"frame {frame.seq}: {name}: {problem}"
    if last != row.last_seq:
        yield f"the last frame is {last}, its row says {row.last_seq}"


def _factors(connection: Connection, key: int, keyframes: int, counts: dict[str, int]) -> Iterator[str]:
    t = schema.factors
    query = select(t.c.factor, t.c.kind, t.c.payload).where(t.c.session == key).order_by(t.c.factor)
    names = {"loop": "loops", "gnss": "gnss_factors"}
    poses, indices = 0, []
    for index, kind, payload in _rows(connection, query):
        indices.append(index)
        if kind in names:
            counts[names[kind]] += 1
        poses += kind in ("prior", "odometry")
        if problem := _problem(json.loads, payload):
            yield f"factor {index}: {problem}"
    yield from _missing("factor", indices)
    if poses != keyframes:
        yield f"{keyframes} keyframes, the graph has {poses} poses"


def _places(connection: Connection, key: int, keyframes: set[int]) -> Iterator[str]:
    t = schema.places
    for (index,) in connection.execute(select(t.c.keyframe).where(t.c.session == key).order_by(t.c.keyframe)):
        if index not in keyframes:
            yield f"place {index} belongs to no keyframe"


def _dense(connection: Connection, key: int, keyframes: set[int]) -> Iterator[str]:
    t = schema.dense_clouds
    query = select(t.c.keyframe, t.c.cloud).where(t.c.session == key).order_by(t.c.keyframe)
    for index, cloud in _rows(connection, query, _DENSE_CLOUDS):
        if index not in keyframes:
            yield f"dense cloud {index} belongs to no keyframe"
        elif problem := _problem(dense_cloud.decode, cloud):
            yield f"keyframe {index}: {problem}"


def _versions(connection: Connection, row: Row, keyframes: int) -> Iterator[str]:
    t = schema.map_versions
    query = select(t.c.version, t.c.first_seq, t.c.poses).where(t.c.session == row.id).order_by(t.c.version)
    versions, last = [], 0
    for version, first_seq, poses in _rows(connection, query, _CLOUDS):
        versions.append(version)
        if first_seq < last:
            yield f"map version {version} begins before the one before it"
        last = first_seq
        if poses is not None and (problem := _problem(unpack_poses, poses)):
            yield f"map version {version}: {problem}"
        elif poses is not None and len(unpack_poses(poses)) > keyframes:
            yield f"map version {version} has keyframes that are not there"
    if versions != list(range((row.map_version or 1) - len(versions) + 1, (row.map_version or 1) + 1)):
        yield f"map versions {versions[:1]} to {versions[-1:]}, its row says {row.map_version or 1}"


def _events(connection: Connection, row: Row) -> Iterator[str]:
    t = schema.events
    query = select(t.c.number, t.c.content).where(t.c.session == row.id).order_by(t.c.number)
    numbers = []
    for number, content in _rows(connection, query):
        numbers.append(number)
        if problem := _problem(_event, content):
            yield f"event {number}: {problem}"
    if numbers != list(range((row.events or 0) - len(numbers) + 1, (row.events or 0) + 1)):
        yield f"events {numbers[:1]} to {numbers[-1:]}, its row says {row.events or 0}"


def _event(content: bytes) -> pb.Event:
    """Raises DataError. What a later program wrote reads as an event of an unknown kind."""
    try:
        return pb.Event.FromString(content)
    except WireError as error:
        raise DataError("corrupt", str(error)) from None


def _rows(connection: Connection, query: Executable, size: int = _ROWS) -> Iterator[Row]:
    with connection.execute(query.execution_options(yield_per=size)) as rows:
        yield from rows


def _missing(what: str, indices: list[int]) -> Iterator[str]:
    """The first number that is not there; they are to be 0, 1, 2, ..."""
    for expected, index in enumerate(indices):
        if index != expected:
            yield f"{what} {expected} is missing"
            return


def _pose_problem(data: bytes | None) -> str:
    if data is None or len(data) != _POSE_BYTES:
        return f"pose of {0 if data is None else len(data)} bytes, expected {_POSE_BYTES}"
    values = np.frombuffer(data, "<f8")
    with np.errstate(over="ignore", invalid="ignore"):
        unit = abs(float(np.linalg.norm(values[3:])) - 1.0) < _UNIT  # also false for NaN
    return "" if unit and np.isfinite(values).all() else "pose that is no rigid transform"


def _problem(read: Callable[[bytes], Any], data: bytes) -> str:
    try:
        read(data)
    except (DataError, ValueError) as error:
        return str(error)
    return ""
