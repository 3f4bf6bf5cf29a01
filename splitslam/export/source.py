"""Where a map comes from: a map service, a store, or the folder of a run."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Protocol

from splitslam.errors import InputError
from splitslam.maps import MapGraph, MapPiece
from splitslam.tum import Trajectory


class MapSource(Protocol):
    """A session's map. Every call raises InputError for what cannot be had, RunFailedError for a server that fails."""

    @property
    def name(self) -> str:
        """For people, and for what is written into files."""
        ...

    @property
    def pieces_expected(self) -> int | None:
        """How many there will be; None: not known."""
        ...

    def pieces(self, voxel_m: float) -> Iterator[MapPiece]:
        """The points, one piece after the other; with voxel_m > 0 each voxel keeps its first point only."""
        ...

    @property
    def has_keyframes(self) -> bool:
        """Are the pieces what single keyframes saw, and is there a graph between them?"""
        ...

    def trajectory(self) -> Trajectory:
        """T_map_lidar of every mapped scan."""
        ...

    def graph(self) -> MapGraph | None:
        """The factor graph; None: this source has none."""
        ...


def open_source(
    session: str, server: str | None, store: str | None, tls: Path | None, dense: bool = True
) -> AbstractContextManager[MapSource]:
    """The source of SESSION: a server (tls: YAML), a store, or the folder SESSION itself. Raises InputError.

    dense: of a server or a store, whole scans of keyframes where there are any.
    """
    if server is not None and store is not None:
        raise InputError("--server, --store: expected one of them, found both")
    if store is not None:
        from splitslam.export.store_source import store_source

        return store_source(session, store, dense)
    if server is not None:
        from splitslam.export.server_source import server_source

        return server_source(session, server, tls, dense)
    from splitslam.export.folder_source import folder_source

    if not Path(session).is_dir():
        raise InputError(
            f"{session}: expected the folder of a run, found none there; "
            "for a session ROBOT/RUN say --server HOST:PORT or --store URL"
        )
    return folder_source(Path(session))
