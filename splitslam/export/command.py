"""One export, from the source to the finished file."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

from splitslam.errors import InputError
from splitslam.export.formats import Format, Kind, check_modules, companion, find_format
from splitslam.export.grid.settings import GridSettings
from splitslam.export.placing import InMap, InUtm, Placing
from splitslam.export.source import MapSource, open_source
from splitslam.export.target import check_target, complete
from splitslam.maps import Georeference, MapPiece
from splitslam.run.processes import interruptible
from splitslam.run.progress import Progress
from splitslam.thinning import voxel_problem

FRAMES = ("auto", "map", "utm")


@dataclass(frozen=True, slots=True)
class ExportOptions:
    """One export. session: ROBOT/RUN, or the folder of a run. out None: the format's own name, here.

    frame: of clouds; auto: utm when GNSS has told where the map lies. dense: whole scans where there are any.
    """

    session: str
    format: str = "ply"
    server: str | None = None
    store: str | None = None
    tls: Path | None = None
    out: Path | None = None
    voxel_m: float = 0.0
    frame: str = "auto"
    force: bool = False
    grid: GridSettings = field(default_factory=GridSettings)
    dense: bool = True


@dataclass(frozen=True, slots=True)
class Exported:
    """What was written. note: what is in it, in a few words."""

    path: Path
    note: str


def export(options: ExportOptions, progress: Progress) -> Exported:
    """Writes one file (KITTI and grids: two) and says what is in it.

    Raises InputError for what can be mended, RunFailedError for a server that fails, OSError for a disk that does.
    Whatever happens, there is no half file under the final name.
    """
    wanted = find_format(options.format)
    if options.frame not in FRAMES:
        raise InputError(f"--frame: expected one of {', '.join(FRAMES)}, found {options.frame!r}")
    if problem := voxel_problem(options.voxel_m):
        raise InputError(f"--voxel: {problem}")
    check_modules(wanted.modules)
    path = options.out or Path(wanted.default)
    second = companion(path, wanted)
    with interruptible(), ExitStack() as stack:
        for target in (path, second):
            if target is not None:
                check_target(target, options.force)
        where = options.server, options.store, options.tls, options.dense
        source = stack.enter_context(open_source(options.session, *where))
        main = stack.enter_context(complete(path, options.force))
        # the second one is in its place before the first, which names it
        beside = None if second is None else stack.enter_context(complete(second, options.force))
        progress.stage(f"reading {source.name}")
        note = _write(wanted, source, options, progress, (main, beside, second))
    return Exported(path, note)


def _write(
    wanted: Format,
    source: MapSource,
    options: ExportOptions,
    progress: Progress,
    paths: tuple[Path, Path | None, Path | None],
) -> str:
    """paths: what to write to, the second file, and the name that this will have."""
    main, beside, second = paths
    if wanted.kind is Kind.CLOUD:
        return _cloud(wanted, source, options, progress, main)
    if wanted.kind is Kind.PATH:
        return _path(wanted, source, main, beside)
    if wanted.kind is Kind.GRAPH:
        return _graph(source, progress, main)
    assert beside is not None
    assert second is not None
    return _grid(source, options, progress, (main, beside, second.name))


def _cloud(wanted: Format, source: MapSource, options: ExportOptions, progress: Progress, path: Path) -> str:
    placing = _placing(source, options, progress)
    dense = DenseCount(source.pieces(options.voxel_m))
    pieces = counted(dense, source.pieces_expected, progress.made)
    count = cloud_writer(wanted.name)(path, pieces, placing, source.name)
    return f"{count} points, {placing.description}{dense.note}"


def cloud_writer(name: str) -> Callable[[Path, Iterable[MapPiece], Placing, str], int]:
    """The writer of a cloud format: (path, pieces, placing, session's name) -> points. Its library is loaded now."""
    if name in ("ply", "pcd"):
        from splitslam.export.clouds import floats

        return floats.write_ply_cloud if name == "ply" else floats.write_pcd_cloud
    if name in ("las", "laz"):
        from splitslam.export.clouds.las import write_las_cloud

        return lambda path, pieces, placing, _: write_las_cloud(path, pieces, placing, compress=name == "laz")
    if name == "copc":
        from splitslam.export.clouds.copc import write_copc_cloud

        return lambda path, pieces, placing, _: write_copc_cloud(path, pieces, placing)
    from splitslam.export.clouds.e57 import write_e57_cloud

    return write_e57_cloud


def counted(pieces: Iterable[MapPiece], expected: int | None, made: Callable[[int, int], None]) -> Iterator[MapPiece]:
    """The same pieces; `made` is told how many of how many have gone by."""
    for done, piece in enumerate(pieces, start=1):
        yield piece
        if expected is not None:
            made(done, max(done, expected))


class DenseCount:
    """The same pieces, once; afterwards it says how many were whole scans."""

    def __init__(self, pieces: Iterable[MapPiece]) -> None:
        self._pieces = pieces
        self.keyframes = self.dense = 0

    def __iter__(self) -> Iterator[MapPiece]:
        for piece in self._pieces:
            self.keyframes += 1
            self.dense += piece.dense
            yield piece

    @property
    def note(self) -> str:
        """For people; nothing where there was none."""
        return f"; {self.dense} of {self.keyframes} keyframes dense" if self.dense else ""


def _placing(source: MapSource, options: ExportOptions, progress: Progress) -> Placing:
    georeference = None if options.frame == "map" else _georeference(source)
    if georeference is None:
        if options.frame == "utm":
            raise InputError(f"--frame utm: {source.name}: GNSS has not told where the map lies; expected map or auto")
        return InMap()
    try:
        check_modules(("pyproj",))
    except InputError as missing:
        if options.frame == "utm":
            raise
        progress.note(f"not georeferenced: {missing}")
        return InMap()
    return InUtm(georeference)


def _georeference(source: MapSource) -> Georeference | None:
    graph = source.graph()
    return None if graph is None else graph.georeference


def _path(wanted: Format, source: MapSource, path: Path, times: Path | None) -> str:
    from splitslam.export.paths import write_geojson, write_kitti
    from splitslam.tum import write_tum

    trajectory = source.trajectory()
    if wanted.name == "geojson":
        georeference = _georeference(source)
        if georeference is None:
            raise InputError(f"{source.name}: GNSS has not told where the map lies, and GeoJSON is on Earth")
        write_geojson(path, trajectory, georeference, source.name)
    elif times is not None:
        write_kitti(path, times, trajectory)
    else:
        write_tum(path, trajectory)
    return f"{len(trajectory)} poses, {trajectory.path_m:.1f} m"


def _graph(source: MapSource, progress: Progress, path: Path) -> str:
    from splitslam.export.g2o import write_g2o

    graph = source.graph()
    if graph is None:
        raise InputError(_NO_KEYFRAMES.format(name=source.name, what="graph"))
    written = write_g2o(path, graph)
    if written.left_out:
        kinds = ", ".join(f"{count} {kind}" for kind, count in sorted(written.left_out.items()))
        progress.note(f"factors that g2o has no line for: {kinds}")
    return f"{written.vertices} vertices, {written.edges} edges"


def _grid(source: MapSource, options: ExportOptions, progress: Progress, paths: tuple[Path, Path, str]) -> str:
    from splitslam.export.grid.nav2 import write_grid

    if not source.has_keyframes:
        raise InputError(_NO_KEYFRAMES.format(name=source.name, what="keyframes"))
    yaml, image, image_name = paths
    dense = DenseCount(source.pieces(0.0))
    pieces = counted(dense, source.pieces_expected, progress.made)
    grid = write_grid(yaml, image, image_name, pieces, options.grid, progress.made)
    cells = f"{grid.occupied} occupied, {grid.free} free"
    return f"{grid.columns} x {grid.rows} cells of {options.grid.resolution_m:g} m, {cells}{dense.note}"


_NO_KEYFRAMES = (
    "{name}: the folder of a run has no {what}: expected a session in a store or at a server "
    "(`splitslam run --server` leaves one there)"
)
