"""One robot's entities: its map by keyframes, its way, its newest scan, its factors, plots and events."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from splitslam import se3
from splitslam.view import colours as c
from splitslam.view.keyframe_blocks import Cloud, KeyframeBlocks, Log, transform
from splitslam.view.rates import Kbps
from splitslam.view.records import Array, Correction, Features, Points, ScanShown
from splitslam.view.strips import Piece
from splitslam.view.thinning import Thinner

COVARIANCE_SCALE = 100.0  # three sigmas of a good pose are millimetres
MOST_LINES = 400  # correspondences of a scan; more of them say no more to the eye
_SIGMAS = 3.0
_COARSER, _FINEST_M = 1.5, 0.05  # a map with more points than wanted: its voxels grow by that, from that at least
_PIECES = 20  # of the way as it was answered, that are one entity
_NEAR_M = 5.0  # the way of a keyframe begins where that of the one before has ended
_LEVELS = {"lost": "ERROR", "degenerate": "WARN", "localising": "WARN", "unanchored": "WARN"}


class RobotScene:
    """A correction logs transforms, and points only where it bends a block of keyframes: keyframe_blocks.py."""

    def __init__(
        self, log: Log, name: str, colours: c.RobotColours, voxel_m: float, most_points: Callable[[], int] | None = None
    ) -> None:
        """log: (stamp_ns, entity path, archetype); without a stamp it holds at all times.

        voxel_m: of the map, 0: every point. most_points: of the map; beyond, the voxels become larger. None: no bound.
        """
        self._log, self._colours = log, colours
        self._name = str(rr.new_entity_path([name]))
        self._world = f"world{self._name}"
        self._thinner, self._most_points = Thinner(voxel_m), most_points
        self._blocks = KeyframeBlocks(log, self._world, {"radii": _ui(1.25)}, _line(colours.way, 2.5))
        self._way, self._way_keyframe = Piece(), -1  # the newest piece, in the frame of that keyframe
        self._last_map: Array | None = None
        self._online = Piece()
        self._online_strips: list[Array] = []  # of the newest entity
        self._online_number = 0
        self._state = ""
        self._kbps = Kbps()
        self._heights_m: tuple[float, float] | None = None
        self._style()

    def _style(self) -> None:
        """What holds at all times: colours, sizes, names of the plots."""
        lidar = f"{self._world}/lidar"
        for part, colour, size in (("corners", c.CORNER, 3.0), ("surfs", c.SURF, 1.5)):
            look = rr.Points3D.from_fields(colors=[colour], radii=rr.Radius.ui_points(size))
            self._log(None, f"{lidar}/{part}", look)
        for path, colour, size in (
            (f"{lidar}/matches", c.MATCH, 0.75),
            (f"{self._world}/loops", c.LOOP, 2.5),
            (f"{self._world}/gnss/factors", c.FIX, 1.0),
        ):
            self._log(None, path, rr.LineStrips3D.from_fields(colors=[colour], radii=_ui(size)))
        fixes = rr.Points3D.from_fields(colors=[c.FIX], radii=rr.Radius.ui_points(4.0))
        self._log(None, f"{self._world}/gnss/fixes", fixes)
        for plot, kind in (("latency", "answer"), ("latency", "registration"), ("latency", "round trip")):
            self._log(None, self._plot(plot, kind), rr.SeriesLines(names=f"{self._name[1:]} {kind}"))
        self._log(None, self._plot("uplink", "kbps"), rr.SeriesLines(colors=[self._colours.way], names=self._name[1:]))
        self._log(None, self._plot("doubt", "position"), rr.SeriesLines(colors=[c.COVARIANCE], names=self._name[1:]))

    def _plot(self, plot: str, kind: str) -> str:
        return f"{plot}{self._name}/{rr.escape_entity_path_part(kind)}"

    # --- the map ----------------------------------------------------------------------------------------------

    @property
    def without_points(self) -> list[int]:
        """Keyframes whose place is known and whose points are not."""
        return self._blocks.without_points

    @property
    def positions_map(self) -> Array:
        """(K, 3) m: where the keyframes are."""
        return np.array([T[:3, 3] for T in self._blocks.poses.values()]).reshape(-1, 3)

    def shows(self, keyframe: int) -> bool:
        """Its points are there."""
        return self._blocks.shows(keyframe)

    def keyframe(self, stamp_ns: int, index: int, T_map_lidar: Array, points_lidar: Points) -> None:
        """A keyframe that was taken just now and its points (N, 3), frame `lidar`; once each."""
        self.move(stamp_ns, {index: T_map_lidar})
        if not self._blocks.shows(index):
            self._blocks.add(stamp_ns, index, self._cloud(T_map_lidar, points_lidar))
            self._thin_out(stamp_ns)

    def stored_keyframe(self, stamp_ns: int, index: int, T_map_lidar: Array, points_lidar: Points) -> None:
        """One of many that were taken before; all of them are shown after `settle`."""
        self.move(stamp_ns, {index: T_map_lidar})
        if not self._blocks.shows(index):
            self._blocks.put(stamp_ns, index, self._cloud(T_map_lidar, points_lidar))
            self._thin_out(stamp_ns)

    def settle(self) -> None:
        """All stored keyframes are there."""
        self._blocks.settle()

    def _cloud(self, T_map_lidar: Array, points_lidar: Points) -> Cloud:
        """What is drawn of a keyframe: where the map has nothing yet, coloured by height."""
        heights_m = points_lidar @ T_map_lidar[2, :3].astype(np.float32) + np.float32(T_map_lidar[2, 3])
        kept = self._thinner.kept(points_lidar @ T_map_lidar[:3, :3].T + T_map_lidar[:3, 3])
        if self._heights_m is None and len(points_lidar):  # of the first keyframe: the colours stay the same then
            low, high = np.percentile(heights_m, [2, 98])
            self._heights_m = float(low), float(max(high, low + 3.0))
        return Cloud(points_lidar[kept], self._colours.by_height(heights_m[kept], *(self._heights_m or (0.0, 1.0))))

    def _thin_out(self, stamp_ns: int) -> None:
        while self._most_points is not None and self._blocks.points > self._most_points():
            self._thinner = Thinner(_COARSER * max(self._thinner.voxel_m, _FINEST_M))
            self._blocks.thin(stamp_ns, self._thinned)

    def _thinned(self, T_map_lidar: Array, cloud: Cloud) -> Cloud:
        kept = self._thinner.kept(cloud.points @ T_map_lidar[:3, :3].T + T_map_lidar[:3, 3])
        return Cloud(cloud.points[kept], cloud.colours[kept])

    def move(self, stamp_ns: int, poses: Mapping[int, Array]) -> None:
        """Keyframes are there now, T_map_lidar by number: with their points and the ways from them."""
        self._blocks.move(stamp_ns, poses)
        if self._way_keyframe in poses:
            self._log(stamp_ns, f"{self._world}/trajectory/newest", transform(poses[self._way_keyframe]))

    def loops(self, stamp_ns: int, pairs: Sequence[tuple[int, int]]) -> None:
        """All loop closures (older, newer keyframe), where their keyframes are now."""
        poses = self._blocks.poses
        ends = [[poses[i][:3, 3] for i in pair] for pair in pairs if poses.keys() >= set(pair)]
        self._log(stamp_ns, f"{self._world}/loops", rr.LineStrips3D.from_fields(strips=np.array(ends, np.float32)))

    def fixes(self, stamp_ns: int, keyframes: Sequence[int], fixes_map: NDArray) -> None:
        """All GNSS factors that are shown: antenna positions (N, 3), frame `map`, and whose factors they are."""
        self._log(stamp_ns, f"{self._world}/gnss/fixes", rr.Points3D.from_fields(positions=fixes_map))
        poses = self._blocks.poses
        known = [i for i, keyframe in enumerate(keyframes) if keyframe in poses]
        lines = [[poses[keyframes[i]][:3, 3], fixes_map[i]] for i in known]
        factors = rr.LineStrips3D.from_fields(strips=np.array(lines, np.float32).reshape(-1, 2, 3))
        self._log(stamp_ns, f"{self._world}/gnss/factors", factors)

    # --- scans ------------------------------------------------------------------------------------------------

    def scan(self, scan: ScanShown, T_corrected: Array | None = None) -> None:
        """The newest scan. T_corrected: (4, 4), its T_map_lidar as its keyframe lies now; None: as it was answered."""
        stamp_ns, T = scan.stamp_ns, scan.T_map_lidar
        self.way(stamp_ns, scan.keyframe, T if T_corrected is None else T_corrected)
        self._answered(stamp_ns, T[:3, 3])
        self._log(stamp_ns, f"{self._world}/lidar", transform(T))
        if scan.features is not None:
            self._features(stamp_ns, scan.features)
        if scan.covariance is not None:
            self._doubt(stamp_ns, scan.covariance)
        self._numbers(scan)
        if scan.state != self._state:
            self.event(stamp_ns, scan.state, _LEVELS.get(scan.state, "INFO"))
            self._state = scan.state
        if scan.correction is not None:
            self._told(stamp_ns, scan.correction)

    def way(self, stamp_ns: int, keyframe: int, T_map_lidar: Array) -> None:
        """The corrected trajectory goes on to T_map_lidar (4, 4), with a keyframe that moves it later."""
        T_keyframe = self._blocks.poses.get(keyframe)
        if T_keyframe is None:
            return
        T_keyframe_map = se3.inv(T_keyframe)
        newest = f"{self._world}/trajectory/newest"
        if keyframe != self._way_keyframe:
            self._end_piece(stamp_ns)
            self._way_keyframe = keyframe
            self._way.begin()
            self._log(stamp_ns, newest, transform(T_keyframe))
            if self._last_map is not None and np.linalg.norm(self._last_map - T_keyframe[:3, 3]) < _NEAR_M:
                self._way.add(_at(T_keyframe_map, self._last_map))
        self._last_map = T_map_lidar[:3, 3]
        if self._way.add(_at(T_keyframe_map, self._last_map)):
            self._log(stamp_ns, newest, rr.LineStrips3D([self._way.points], **_line(self._colours.way, 2.5)))
        if self._way.full:
            self._end_piece(stamp_ns)

    def _end_piece(self, stamp_ns: int) -> None:
        if pieces := self._way.taken():
            self._blocks.add_way(stamp_ns, self._way_keyframe, pieces)

    def _answered(self, stamp_ns: int, position_map: Array) -> None:
        if not self._online.add(position_map):
            return
        style, online = _line(self._colours.online, 1.25), f"{self._world}/online"
        self._log(stamp_ns, f"{online}/newest", rr.LineStrips3D([self._online.points], **style))
        if self._online.full:
            self._online_strips += self._online.taken()
            self._log(stamp_ns, f"{online}/{self._online_number}", rr.LineStrips3D(self._online_strips, **style))
            if len(self._online_strips) == _PIECES:
                self._online_strips, self._online_number = [], self._online_number + 1

    def _features(self, stamp_ns: int, features: Features) -> None:
        lidar = f"{self._world}/lidar"
        self._log(stamp_ns, f"{lidar}/corners", rr.Points3D.from_fields(positions=features.corners_lidar))
        self._log(stamp_ns, f"{lidar}/surfs", rr.Points3D.from_fields(positions=features.surfs_lidar))
        matches = rr.LineStrips3D.from_fields(strips=features.correspondences_lidar(MOST_LINES))
        self._log(stamp_ns, f"{lidar}/matches", matches)

    def _doubt(self, stamp_ns: int, covariance: Array) -> None:
        values, axes = np.linalg.eigh(covariance[3:, 3:])
        if not np.isfinite(values).all():
            return
        sigmas_m = np.sqrt(np.maximum(values, 0.0))
        if np.linalg.det(axes) < 0:
            axes[:, 0] = -axes[:, 0]
        ellipsoid = rr.Ellipsoids3D(
            half_sizes=[_SIGMAS * COVARIANCE_SCALE * sigmas_m],
            quaternions=[rr.Quaternion(xyzw=se3.quat_from_matrix(axes))],
            colors=[c.COVARIANCE],
            line_radii=rr.Radius.ui_points(1.0),
        )
        self._log(stamp_ns, f"{self._world}/lidar/covariance", ellipsoid)
        self._log(stamp_ns, self._plot("doubt", "position"), rr.Scalars(sigmas_m.max() * 1e3))

    # --- numbers and words ------------------------------------------------------------------------------------

    def _numbers(self, scan: ScanShown) -> None:
        times_ms = {
            "answer": scan.answer_ms,
            "registration": scan.registration_ms,
            "round trip": scan.round_trip_ms,
        }
        for kind, value in times_ms.items():
            if np.isfinite(value):
                self._log(scan.stamp_ns, self._plot("latency", kind), rr.Scalars(value))
        if np.isfinite(scan.frame_bytes):
            kbps = self._kbps.add(scan.stamp_ns, scan.frame_bytes)
            self._log(scan.stamp_ns, self._plot("uplink", "kbps"), rr.Scalars(kbps))

    def _told(self, stamp_ns: int, correction: Correction) -> None:
        size = f"{correction.translation_m * 100:.1f} cm, {np.degrees(correction.rotation_rad):.2f} deg"
        self.event(stamp_ns, f"map corrected: {correction.cause}, {size}", "INFO")

    def event(self, stamp_ns: int, text: str, level: str = "INFO") -> None:
        """A line for the panel of events."""
        self._log(stamp_ns, f"events{self._name}", rr.TextLog(text, level=level))


def _ui(size: float) -> Any:
    """A radius in the page's points, whatever the distance."""
    return rr.Radius.ui_points(size)


def _line(colour: c.Rgb, size: float) -> dict[str, Any]:
    return {"colors": [colour], "radii": _ui(size)}


def _at(T: Array, point: Array) -> Array:
    return T[:3, :3] @ point + T[:3, 3]
