"""`map-service store ...` and `map-service sessions ...`: an operator's work on a store, services running or not."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from splitslam.errors import InputError

if TYPE_CHECKING:
    from map_service.store import Store

ConfigFile = Annotated[Path | None, typer.Option(metavar="FILE", help="The service's YAML; defaults without.")]
StoreUrl = Annotated[str | None, typer.Option("--store", metavar="URL", help="sqlite:///FILE or postgresql://...")]

store_app = typer.Typer(help="The store: migrate, backup, restore, check, compact.", no_args_is_help=True)
sessions_app = typer.Typer(help="The sessions in a store: list, show, export, delete.", no_args_is_help=True)


# -- store --------------------------------------------------------------------------------------------------------


@store_app.command()
def migrate(
    to: Annotated[
        int | None, typer.Option(min=1, help="Schema version; default: the newest this program knows.")
    ] = None,
    config: ConfigFile = None,
    store: StoreUrl = None,
) -> None:
    """Bring the tables to a schema version. Back to an older one drops what it does not know."""
    from map_service import database, migrations

    engine = database.plain_engine(_url(config, store))
    with database.input_errors(engine):
        done = migrations.migrate(engine, migrations.VERSION if to is None else to)
    before = f"schema version {done.before}" if done.before else "no store"
    print(f"{before} -> schema version {done.after}" if done.before != done.after else f"{before} already")


@store_app.command()
def backup(file: Path, config: ConfigFile = None, store: StoreUrl = None) -> None:
    """Write all sessions as of now into FILE; services go on meanwhile."""
    from map_service import archive

    with _opened(config, store) as opened:
        done = archive.backup(opened, file)
    print(f"{file}: {done.sessions} sessions, {done.frames} frames, {done.keyframes} keyframes, {done.bytes} bytes")


@store_app.command()
def restore(
    file: Path,
    config: ConfigFile = None,
    store: StoreUrl = None,
    force: Annotated[bool, typer.Option("--force", help="Replace the sessions that are there.")] = False,
) -> None:
    """Make the store what the backup FILE holds; the engine may be another."""
    from map_service import archive

    with _opened(config, store, make=True) as opened:
        done = archive.restore(opened, file, force)
    print(f"{file}: {done.sessions} sessions, {done.frames} frames, {done.keyframes} keyframes restored")


@store_app.command()
def check(config: ConfigFile = None, store: StoreUrl = None) -> None:
    """Look at every row; one line for each finding, and exit code 1 if there is any."""
    from map_service.integrity import Seen, findings

    found = 0
    seen = Seen()
    with _opened(config, store) as opened:
        for finding in findings(opened, seen):
            found += 1
            print(finding)
    if found:
        raise typer.Exit(1)
    print(f"sound: {seen.sessions} sessions, {seen.frames} frames, {seen.keyframes} keyframes")


@store_app.command()
def compact(config: ConfigFile = None, store: StoreUrl = None) -> None:
    """Give free space back to the file system; may write the whole file anew while services wait."""
    from map_service.space import release

    with _opened(config, store) as opened:
        done = release(opened, rewrite=True)
    print(f"{done.before_bytes} -> {done.after_bytes} bytes: {done.note}")


# -- sessions -----------------------------------------------------------------------------------------------------


@sessions_app.command("list")
def list_sessions(
    site: Annotated[str, typer.Option(help="Of one site only.")] = "", config: ConfigFile = None, store: StoreUrl = None
) -> None:
    """One line a session, in the order they were opened."""
    from map_service.catalog import Catalog

    with _opened(config, store) as opened:
        rows = Catalog(opened).sessions(site)
    for row in rows:
        state = "finished" if row.finished else "open"
        sizes = f"{row.frames} frames  {row.keyframes} keyframes  {row.bytes} bytes"
        print(f"{row.session_id}  {row.site_id or '-'}  {state}  {sizes}")


@sessions_app.command()
def show(session_id: str, config: ConfigFile = None, store: StoreUrl = None) -> None:
    """What the store knows of one session, as JSON."""
    from map_service.catalog import Catalog

    with _opened(config, store) as opened:
        row = Catalog(opened).session(session_id)
    if row is None:
        raise InputError(f"no session {session_id!r}")
    values = {key: value for key, value in row._asdict().items() if key not in ("id", "tracker", "robot_file")}
    values["statistics"] = json.loads(row.statistics or "{}")
    print(json.dumps(values, indent=2))


@sessions_app.command()
def export(
    session_id: str,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where map.ply and trajectory.tum go.")],
    voxel_m: Annotated[float, typer.Option(min=0.0, help="One point a voxel of this size; 0: every point.")] = 0.0,
    config: ConfigFile = None,
    store: StoreUrl = None,
) -> None:
    """Write a session's map and trajectory, as they are now, to files; its robot may be driving."""
    from map_service.catalog import Catalog
    from map_service.export import write_session
    from splitslam.errors import DataError
    from splitslam.run.staging import staging
    from splitslam.thinning import voxel_problem

    if problem := voxel_problem(voxel_m):
        raise InputError(f"--voxel-m: {problem}")
    with _opened(config, store) as opened, staging(out) as stage:
        catalog = Catalog(opened)
        if (row := catalog.session(session_id)) is None:
            raise InputError(f"no session {session_id!r}")
        try:
            done = write_session(catalog, row.id, stage.results, voxel_m)
        except DataError as error:
            raise InputError(f"session {session_id!r}: {error} (see `map-service store check`)") from None
        stage.publish()
    print(f"{out / 'map.ply'}: {done.points} points\n{out / 'trajectory.tum'}: {done.poses} poses")


@sessions_app.command()
def delete(
    session_id: str,
    config: ConfigFile = None,
    store: StoreUrl = None,
    force: Annotated[
        bool, typer.Option("--force", help="Also one that has not ended: its robot may be driving.")
    ] = False,
) -> None:
    """Remove a session with everything that was stored of it, and give its space back."""
    from map_service.catalog import Catalog
    from map_service.space import release

    with _opened(config, store) as opened:
        row = Catalog(opened).session(session_id)
        if row is None:
            raise InputError(f"no session {session_id!r}")
        if not (row.finished or force):
            raise InputError(
                f"session {session_id!r} has not ended: its robot could not go on with it (--force deletes it)"
            )
        removed = Catalog(opened).delete(session_id)
        space = release(opened)
    if removed is None:
        raise InputError(f"no session {session_id!r}: somebody else has just deleted it")
    print(f"deleted {session_id}: {removed.frames} frames, {removed.keyframes} keyframes, {removed.bytes} bytes")
    print(f"store: {space.before_bytes} -> {space.after_bytes} bytes: {space.note}")


# -- common -------------------------------------------------------------------------------------------------------


def _url(config: Path | None, store: str | None) -> str:
    from map_service.config import ENV_PREFIX, ServiceConfig
    from splitslam import config as configuration

    return store or configuration.load(ServiceConfig, config, ENV_PREFIX).store


@contextmanager
def _opened(config: Path | None, url: str | None, make: bool = False) -> Iterator[Store]:
    """make: a store that is not there is made. Raises InputError, also for a store that stops answering."""
    from map_service import database
    from map_service.store import Store

    named = _url(config, url)
    if not make:
        database.check_exists(named)
    store = Store(named)
    try:
        yield store
    except database.StoreError as error:
        raise InputError(f"store: {database.shown(named)}: {error}") from error
    finally:
        store.close()
