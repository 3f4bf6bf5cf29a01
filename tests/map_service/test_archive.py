"""Backup and restore between any two engines, and what must not be taken for a backup."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import select

from map_service import archive, schema
from map_service.archive import backup, restore
from map_service.catalog import Catalog
from map_service.store import FencedError, Store
from splitslam.errors import InputError
from tests.map_service.entries import OPENING, entry, sound

SESSIONS = ("r/1", "r/2")


def filled(store: Store) -> None:
    for session_id in SESSIONS:
        opened = store.open_session(replace(OPENING, session_id=session_id))
        store.commit(opened.key, 1, sound())


def content(store: Store) -> dict[str, list[tuple[Any, ...]]]:
    """All rows but for the keys and epochs of sessions, by table."""
    rows = {}
    with store.reading() as connection:
        names = dict(connection.execute(select(schema.sessions.c.id, schema.sessions.c.session_id)).all())  # type: ignore[arg-type]
        for table in (schema.sessions, *schema.SESSION_TABLES):
            found = [row._asdict() for row in connection.execute(select(table))]
            for row in found:
                row["id" if table is schema.sessions else "session"] = names[row.get("session", row.get("id"))]
                row.pop("epoch", None)
            rows[table.name] = sorted(tuple(row.values()) for row in found)
    return rows


@pytest.fixture(params=["sqlite", "postgresql"])
def other(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Store]:
    """A second store, empty."""
    if request.param == "sqlite":
        url = f"sqlite:///{tmp_path}/other.db"
    else:
        url = request.getfixturevalue("postgres").empty_database("other")
    store = Store(url)
    yield store
    store.close()


def test_what_was_backed_up_is_restored_on_any_engine(store: Store, other: Store, tmp_path: Path) -> None:
    filled(store)
    done = backup(store, tmp_path / "backup")
    assert (done.sessions, done.frames, done.keyframes) == (2, 14, 4)
    assert restore(other, tmp_path / "backup") == done
    assert content(other) == content(store)
    assert sorted(path.name for path in tmp_path.glob("backup*")) == ["backup"]
    again = other.open_session(replace(OPENING, session_id="r/2"))
    assert (again.epoch, again.last_seq) == (3, 9)
    other.commit(again.key, 3, entry(9, 11))
    new = other.open_session(replace(OPENING, session_id="r/3"))
    assert new.key > again.key


def test_the_owner_of_a_session_that_was_restored_cannot_go_on(store: Store, tmp_path: Path) -> None:
    filled(store)
    backup(store, tmp_path / "backup")
    (key,) = {row.id for row in Catalog(store).sessions() if row.session_id == "r/1"}
    restore(store, tmp_path / "backup", force=True)
    with pytest.raises(FencedError):
        store.commit(key, 1, entry(9, 11))


def test_a_backup_sees_one_moment_while_the_service_goes_on(
    store: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    filled(store)
    before = content(store)
    batches, key = archive._batches, Catalog(store).sessions()[0].id

    def meanwhile(connection: Any, table: Any, columns: Any) -> Any:
        yield from batches(connection, table, columns)
        if table is schema.sessions:
            store.commit(key, 1, entry(9, 11))

    monkeypatch.setattr(archive, "_batches", meanwhile)
    backup(store, tmp_path / "backup")
    monkeypatch.undo()
    assert content(store) != before
    restore(store, tmp_path / "backup", force=True)
    assert content(store) == before


def test_a_store_with_sessions_is_not_restored_over_without_being_told(store: Store, tmp_path: Path) -> None:
    filled(store)
    backup(store, tmp_path / "backup")
    store.open_session(replace(OPENING, session_id="r/3"))
    before = content(store)
    with pytest.raises(InputError, match="holds 3 sessions; --force"):
        restore(store, tmp_path / "backup")
    assert content(store) == before
    restore(store, tmp_path / "backup", force=True)
    assert [row.session_id for row in Catalog(store).sessions()] == list(SESSIONS)


def change(statement: str) -> Callable[[Path], None]:
    def do(path: Path) -> None:
        connection = sqlite3.connect(path)
        connection.execute(statement)
        connection.commit()
        connection.close()

    return do


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def flip(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[data.index(b"place 1")] ^= 1
    path.write_bytes(data)


@pytest.mark.parametrize(
    ("harm", "said"),
    [
        pytest.param(cut, "damaged", id="cut off"),
        pytest.param(flip, "damaged: table `places` is not what was written", id="a bit flipped"),
        pytest.param(change("DELETE FROM frames WHERE seq = 3"), "damaged: table `frames`", id="a row gone"),
        pytest.param(lambda p: p.write_text("soup" * 4000), "damaged", id="another file"),
        pytest.param(change("DROP TABLE archive"), "not a backup", id="a store, not a backup"),
        pytest.param(change("UPDATE meta SET value = 9"), "schema version 9", id="of a later version"),
        pytest.param(lambda p: p.unlink(), "no such file", id="not there"),
    ],
)
def test_a_file_that_is_no_sound_backup_is_one_line_and_changes_nothing(
    tmp_path: Path, harm: Callable[[Path], None], said: str
) -> None:
    store = Store(f"sqlite:///{tmp_path}/map.db")
    filled(store)
    backup(store, tmp_path / "backup")
    before = content(store)
    harm(tmp_path / "backup")
    with pytest.raises(InputError) as error:
        restore(store, tmp_path / "backup", force=True)
    assert said in str(error.value)
    assert "\n" not in str(error.value)
    assert content(store) == before
    store.close()


def test_a_backup_overwrites_nothing_and_leaves_no_half(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = Store(f"sqlite:///{tmp_path}/map.db")
    filled(store)
    (tmp_path / "taken").write_text("precious")
    with pytest.raises(InputError, match="is there already"):
        backup(store, tmp_path / "taken")
    assert (tmp_path / "taken").read_text() == "precious"
    with pytest.raises(InputError, match=r"^/proc/backup\.sqlite: expected a folder that can be written"):
        backup(store, Path("/proc/backup.sqlite"))
    with pytest.raises(InputError, match="no directory"):
        backup(store, tmp_path / "no" / "where")
    monkeypatch.setattr("map_service.archive._add", lambda digest, rows: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        backup(store, tmp_path / "half")
    assert not list(tmp_path.glob("half*"))
    store.close()
