"""Schema versions: a store of the last one is taken along and back, replicas of two versions share one."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import pytest
from sqlalchemy import Engine, create_engine, inspect, select, text, update

from map_service import migrations, schema
from map_service.catalog import Catalog
from map_service.database import open_engine
from map_service.migrations import VERSION, Migrated, migrate
from map_service.store import Store
from splitslam.errors import InputError
from tests.map_service.entries import OPENING, entry

# As version 1 made it, written down: what the code of today makes must not decide what the past looked like.
VERSION_1 = """
CREATE TABLE meta ("key" VARCHAR(64) NOT NULL, value TEXT NOT NULL, PRIMARY KEY ("key"));
CREATE TABLE sessions (id {id}, session_id VARCHAR(180) NOT NULL,
 robot_id VARCHAR(128) NOT NULL, run_id VARCHAR(64) NOT NULL, site_id VARCHAR(128) NOT NULL,
 map_id VARCHAR(128) NOT NULL, robot_file TEXT NOT NULL, opened_s FLOAT NOT NULL, epoch BIGINT NOT NULL,
 last_seq BIGINT NOT NULL, finished BOOLEAN NOT NULL, first_stamp_ns BIGINT NOT NULL, last_stamp_ns BIGINT NOT NULL,
 frames BIGINT NOT NULL, rejected BIGINT NOT NULL, keyframes BIGINT NOT NULL, loops BIGINT NOT NULL,
 gnss_factors BIGINT NOT NULL, bytes BIGINT NOT NULL, tracker {blob} NOT NULL, statistics TEXT NOT NULL,
 UNIQUE (session_id));
CREATE INDEX sessions_by_site ON sessions (site_id);
CREATE TABLE frames (session {key} NOT NULL, seq BIGINT NOT NULL, stamp_ns BIGINT NOT NULL, state INTEGER NOT NULL,
 keyframe INTEGER, pose_keyframe_lidar {blob}, online_map_lidar {blob}, online_map_odom {blob},
 rejected VARCHAR(64) NOT NULL, PRIMARY KEY (session, seq), FOREIGN KEY(session) REFERENCES sessions (id));
CREATE TABLE keyframes (session {key} NOT NULL, keyframe INTEGER NOT NULL, seq BIGINT NOT NULL,
 stamp_ns BIGINT NOT NULL, pose_map_lidar {blob} NOT NULL, PRIMARY KEY (session, keyframe),
 FOREIGN KEY(session) REFERENCES sessions (id));
CREATE TABLE clouds (session {key} NOT NULL, keyframe INTEGER NOT NULL, cloud {blob} NOT NULL,
 PRIMARY KEY (session, keyframe), FOREIGN KEY(session) REFERENCES sessions (id));
CREATE TABLE factors (session {key} NOT NULL, factor BIGINT NOT NULL, kind VARCHAR(16) NOT NULL,
 payload {blob} NOT NULL, PRIMARY KEY (session, factor), FOREIGN KEY(session) REFERENCES sessions (id));
INSERT INTO meta VALUES ('schema_version', '1');
INSERT INTO sessions (session_id, robot_id, run_id, site_id, map_id, robot_file, opened_s, epoch, last_seq, finished,
 first_stamp_ns, last_stamp_ns, frames, rejected, keyframes, loops, gnss_factors, bytes, tracker, statistics)
 VALUES ('r/1', 'r', '1', 'site', '', 'robot: {{}}', 1.5, 4, 0, {false}, 0, 0, 0, 0, 0, 0, 0, 0, {empty}, '')
"""
TYPES = {
    "sqlite": {"id": "INTEGER NOT NULL PRIMARY KEY AUTOINCREMENT", "key": "INTEGER", "blob": "BLOB",
               "false": "0", "empty": "x''"},
    "postgresql": {"id": "BIGSERIAL PRIMARY KEY", "key": "BIGINT", "blob": "BYTEA", "false": "false", "empty": "''"},
}  # fmt: skip


@pytest.fixture
def old_url(url: str) -> str:
    """A store of version 1 with a session in it."""
    engine = create_engine(url.replace("postgresql:", "postgresql+psycopg:"))
    with engine.begin() as connection:
        for statement in VERSION_1.format(**TYPES[engine.dialect.name]).split(";"):
            connection.execute(text(statement))
    engine.dispose()
    return url


def columns(engine: Engine) -> dict[str, dict[str, str]]:
    tables = inspect(engine)
    return {t: {c["name"]: str(c["type"]) for c in tables.get_columns(t)} for t in tables.get_table_names()}


def version(engine: Engine) -> str | None:
    with engine.connect() as connection:
        return connection.execute(select(schema.meta.c.value).where(schema.meta.c.key == "schema_version")).scalar()


def test_a_store_of_the_first_version_is_taken_along_with_its_sessions(old_url: str) -> None:
    store = Store(old_url)
    opened = store.open_session(OPENING)
    assert (opened.epoch, opened.last_seq) == (5, 0)
    store.commit(opened.key, 5, entry(0, 3, keyframes=(0,), holes=[(2, 0)], finished=True))
    assert store.load(opened.key).places == [b"place 0"]
    row = Catalog(store).session("r/1")
    assert row is not None
    assert row.finished_s > 1.5
    store.close()


def test_tables_that_were_migrated_are_those_that_are_made_today(url: str, old_url: str) -> None:
    engine = open_engine(old_url)
    migrated = columns(engine)
    with engine.begin() as connection:
        schema.metadata.drop_all(connection)
    migrate(engine)
    assert columns(engine) == migrated
    assert version(engine) == str(VERSION)
    engine.dispose()


def test_the_way_back_leaves_what_the_older_version_knows(old_url: str) -> None:
    plain = create_engine(old_url.replace("postgresql:", "postgresql+psycopg:"))
    before = columns(plain)
    store = Store(old_url)
    opened = store.open_session(OPENING)
    store.commit(opened.key, opened.epoch, entry(0, 3, keyframes=(0,), holes=[(2, 0)]))
    assert migrate(store.engine, 1) == Migrated(VERSION, 1)
    assert columns(plain) == before
    assert migrate(store.engine) == Migrated(1, VERSION)
    assert (store.load(opened.key).mapped, store.load(opened.key).places) == (3, [])
    store.close()
    plain.dispose()


def test_replicas_that_start_together_migrate_once(old_url: str) -> None:
    with ThreadPoolExecutor(6) as threads:
        stores = list(threads.map(Store, [old_url] * 6))
    assert stores[0].open_session(OPENING).epoch == 5
    for store in stores:
        store.close()


def test_a_service_works_on_a_store_of_the_next_version(url: str) -> None:
    """A replica that was upgraded has added a table and a column; this one has not been yet."""
    engine = open_engine(url)
    with engine.execution_options(write=True).begin() as connection:
        connection.execute(text("ALTER TABLE sessions ADD COLUMN mood VARCHAR(8)"))
        connection.execute(text("CREATE TABLE moods (mood VARCHAR(8) PRIMARY KEY)"))
        connection.execute(update(schema.meta).values(value=str(VERSION + 1)))
    engine.dispose()
    store = Store(url)
    opened = store.open_session(OPENING)
    store.commit(opened.key, 1, entry(0, 3, keyframes=(0,)))
    assert store.load(opened.key).mapped == 3
    with pytest.raises(InputError, match="take a newer program"):
        migrate(store.engine, 1)
    store.close()


@pytest.mark.parametrize(
    ("found", "said"),
    [
        (str(VERSION + 2), f"schema version {VERSION + 2}: this service works with 1 to {VERSION + 1}"),
        ("0", "schema version 0: there is a way to 4 only from 1 to 4; take an older program"),
        ("soup", "'soup': expected a number; the database is not a store"),
    ],
)
def test_a_version_that_cannot_be_used_is_one_line(url: str, found: str, said: str) -> None:
    store = Store(url)
    with store.writing() as connection:
        connection.execute(update(schema.meta).values(value=found))
    store.close()
    with pytest.raises(InputError) as error:
        Store(url)
    assert said in str(error.value)
    assert "\n" not in str(error.value)


def test_there_is_no_way_to_a_version_that_nobody_knows(url: str) -> None:
    engine = open_engine(url)
    with pytest.raises(InputError, match="no way to schema version 7"):
        migrate(engine, 7)
    engine.dispose()


def test_a_migration_that_fails_leaves_the_store_as_it_was(old_url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    plain = create_engine(old_url.replace("postgresql:", "postgresql+psycopg:"))
    before = columns(plain)
    broken = migrations.Migration(2, tables=(schema.holes,), columns=(schema.sessions.c.bytes,))  # is there already
    monkeypatch.setattr(migrations, "MIGRATIONS", (broken,))
    with pytest.raises(Exception, match="bytes"):
        Store(old_url)
    assert (columns(plain), version(plain)) == (before, "1")
    plain.dispose()
