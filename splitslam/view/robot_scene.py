"""One robot's entities: its map by keyframes, its way, its newest scan, its factors, plots and events."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from splitslam import se3
from splitslam.view import colours as c
from splitslam.view.rates import Kbps
from splitslam.view.records import Array, Correction, Features, Points, ScanShown
from splitslam.view.strips import Strip, Strips
from splitslam.view.thinning import Thinner

Log = Callable[[int | None, str, rr.AsComponents], None]
COVARIANCE_SCALE = 100.0  # three sigmas of a good pose are millimetres
MOST_LINES = 400  # correspondences of a scan; more of them say no more to the eye
_SIGMAS = 3.0
_LEVELS = {"lost": "ERROR", "degenerate": "WARN", "localising": "WARN", "unanchored": "WARN"}


class RobotScene:
    """Keyframes are points that are logged once, in their own frame; a correction logs transforms and nothing else."""

    def __init__(self, log: Log, name: str, colours: c.RobotColours, voxel_m: float) -> None:
        """log: (stamp_ns, entity path, archetype); without a stamp it holds at all times."""
        self._log, self._colours = log, colours
        self._name = str(rr.new_entity_path([name]))
        self._world = f"world{self._name}"
        self._thinner = Thinner(voxel_m)
        self._poses: dict[int, Array] = {}
        self._shown: set[int] = set()
        self._ways: dict[int, Strips] = {}
        self._online = Strips()
        self._last_map: Array | None = None
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
            self._log(None, path, rr.LineStrips3D.from_fields(colors=[colour], radii=rr.Radius.ui_points(size)))
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
        return sorted(self._poses.keys() - self._shown)

    @property
    def positions_map(self) -> Array:
        """(K, 3) m: where the keyframes are."""
        return np.array([T[:3, 3] for T in self._poses.values()]).reshape(-1, 3)

    def shows(self, keyframe: int) -> bool:
        """Its points are there."""
        return keyframe in self._shown

    def keyframe(self, stamp_ns: int, index: int, T_map_lidar: Array, points_lidar: Points) -> None:
        """A keyframe and its points (N, 3), frame `lidar`; once each."""
        self.move(stamp_ns, index, T_map_lidar)
        if index in self._shown:
            return
        self._shown.add(index)
        heights_m = points_lidar @ T_map_lidar[2, :3].astype(np.float32) + np.float32(T_map_lidar[2, 3])
        points_map = points_lidar @ T_map_lidar[:3, :3].T + T_map_lidar[:3, 3]
        kept = self._thinner.kept(points_map)
        if self._heights_m is None and len(points_lidar):  # of the first keyframe: the colours stay the same then
            low, high = np.percentile(heights_m, [2, 98])
            self._heights_m = float(low), float(max(high, low + 3.0))
        shades = self._colours.by_height(heights_m[kept], *(self._heights_m or (0.0, 1.0)))
        points = rr.Points3D(points_lidar[kept], colors=shades, radii=rr.Radius.ui_points(1.25))
        self._log(stamp_ns, f"{self._world}/map/{index}", points)

    def move(self, stamp_ns: int, index: int, T_map_lidar: Array) -> None:
        """A keyframe is there now: its points and the way from it are logged no second time."""
        self._poses[index] = T_map_lidar
        for tree in ("map", "trajectory"):
            self._log(stamp_ns, f"{self._world}/{tree}/{index}", _transform(T_map_lidar))

    def loops(self, stamp_ns: int, pairs: Sequence[tuple[int, int]]) -> None:
        """All loop closures (older, newer keyframe), where their keyframes are now."""
        ends = [[self._poses[i][:3, 3] for i in pair] for pair in pairs if self._poses.keys() >= set(pair)]
        self._log(stamp_ns, f"{self._world}/loops", rr.LineStrips3D.from_fields(strips=np.array(ends, np.float32)))

    def fixes(self, stamp_ns: int, keyframes: Sequence[int], fixes_map: NDArray) -> None:
        """All GNSS factors that are shown: antenna positions (N, 3), frame `map`, and whose factors they are."""
        self._log(stamp_ns, f"{self._world}/gnss/fixes", rr.Points3D.from_fields(positions=fixes_map))
        known = [i for i, keyframe in enumerate(keyframes) if keyframe in self._poses]
        lines = [[self._poses[keyframes[i]][:3, 3], fixes_map[i]] for i in known]
        factors = rr.LineStrips3D.from_fields(strips=np.array(lines, np.float32).reshape(-1, 2, 3))
        self._log(stamp_ns, f"{self._world}/gnss/factors", factors)

    # --- scans ------------------------------------------------------------------------------------------------

    def scan(self, scan: ScanShown, T_corrected: Array | None = None) -> None:
        """The newest scan. T_corrected: (4, 4), its T_map_lidar as its keyframe lies now; None: as it was answered."""
        stamp_ns, T = scan.stamp_ns, scan.T_map_lidar
        self.way(stamp_ns, scan.keyframe, T if T_corrected is None else T_corrected)
        if (strip := self._online.add(T[:3, 3])) is not None:
            self._draw(stamp_ns, f"{self._world}/online", strip, self._colours.online, 1.25)
        self._log(stamp_ns, f"{self._world}/lidar", _transform(T))
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
        T_keyframe = self._poses.get(keyframe)
        if T_keyframe is None:
            return
        T_keyframe_map = se3.inv(T_keyframe)
        strips = self._ways.get(keyframe)
        if strips is None:
            strips = self._ways[keyframe] = Strips()
            if self._last_map is not None and np.linalg.norm(self._last_map - T_keyframe[:3, 3]) < 5.0:
                strips.add(_at(T_keyframe_map, self._last_map))  # without a gap from the keyframe before
        self._last_map = T_map_lidar[:3, 3]
        if (strip := strips.add(_at(T_keyframe_map, self._last_map))) is not None:
            self._draw(stamp_ns, f"{self._world}/trajectory/{keyframe}", strip, self._colours.way, 2.5)

    def _draw(self, stamp_ns: int, path: str, strip: Strip, colour: c.Rgb, size: float) -> None:
        line = rr.LineStrips3D([strip.points], colors=[colour], radii=rr.Radius.ui_points(size))
        self._log(stamp_ns, f"{path}/{strip.number}", line)

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


def _transform(T: Array) -> rr.Transform3D:
    return rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3])


def _at(T: Array, point: Array) -> Array:
    return T[:3, :3] @ point + T[:3, 3]
