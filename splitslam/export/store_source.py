"""A session out of a store, without a map service."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, contextmanager

from splitslam.errors import DataError, InputError
from splitslam.maps import MapGraph, MapPiece
from splitslam.run.options import check_installed
from splitslam.tum import Trajectory


class StoreSource:
    """A row of the store's sessions with what belongs to it."""

    def __init__(self, catalog, row, dense: bool = True) -> None:
        """catalog: map_service.catalog.Catalog; row: of its sessions. dense: whole scans where there are any."""
        self._catalog, self._row, self._dense = catalog, row, dense

    @property
    def name(self) -> str:
        return self._row.session_id

    @property
    def pieces_expected(self) -> int | None:
        return self._row.keyframes

    @property
    def has_keyframes(self) -> bool:
        return True

    def pieces(self, voxel_m: float) -> Iterator[MapPiece]:
        """As MapSource."""
        from map_service.export import map_pieces

        with closing(self._catalog.keyframes(self._row.id, dense=self._dense)) as keyframes:
            yield from map_pieces(keyframes, voxel_m)

    def trajectory(self) -> Trajectory:
        """As MapSource."""
        from map_service.export import trajectory

        return trajectory(self._catalog, self._row.id)

    def graph(self) -> MapGraph | None:
        """As MapSource."""
        from map_service.graph_export import map_graph

        return map_graph(self._catalog.graph(self._row.id))


@contextmanager
def store_source(session_id: str, url: str, dense: bool = True) -> Iterator[StoreSource]:
    """Raises InputError for a store or session that is not there, damaged rows, a store that fails."""
    check_installed(("server",))
    from map_service import database
    from map_service.catalog import Catalog
    from map_service.store import Store

    database.check_exists(url)
    store = Store(url)
    try:
        catalog = Catalog(store)
        if (row := catalog.session(session_id)) is None:
            raise InputError(f"{database.shown(url)}: no session {session_id!r}")
        yield StoreSource(catalog, row, dense)
    except DataError as error:
        raise InputError(f"session {session_id!r}: {error} (see `map-service store check`)") from None
    except database.StoreError as error:
        raise InputError(f"store: {database.shown(url)}: {error}") from error
    finally:
        store.close()
