"""A map and its way in blocks of keyframes: what a viewer spends on a frame grows with the number of its entities.

The newest keyframes have an entity each, one of NEWEST that are used in turn. Together they are folded into the one
entity of their block: its points in the frame of its first keyframe, so that a correction of the whole of it logs one
transform. Its points are logged anew only when keyframes are folded into it, or when it is bent: when a keyframe in it
has moved against the first one so far that the eye sees it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from splitslam import se3
from splitslam.view.records import NO_POINTS, Array, Points

Log = Callable[[int | None, str, rr.AsComponents], None]
Colours = NDArray[np.uint8]
NEWEST, BLOCK = 8, 32
_BENT_M, _REACH_M = 0.05, 20.0  # half a voxel of the map, as seen at the end of a lever such as scans have


@dataclass(frozen=True, slots=True, eq=False)
class Cloud:
    """points: (N, 3) float32, m, in the frame of their keyframe. colours: (N, 3)."""

    points: Points
    colours: Colours


@dataclass(slots=True, eq=False)
class _Block:
    """clouds, ways: of its keyframes, the newest ones not yet among the clouds. first: in whose frame they are drawn.

    drawn: T_first_keyframe as they were logged. logged_ns: what came late belongs to the newest picture.
    """

    number: int
    first: int
    clouds: dict[int, Cloud] = field(default_factory=dict)
    ways: dict[int, list[Array]] = field(default_factory=dict)
    drawn: dict[int, Array] = field(default_factory=dict)
    logged_ns: int = 0


class KeyframeBlocks:
    """Of one robot. poses: T_map_lidar (4, 4) of its keyframes, as they are now. points: how many are drawn."""

    def __init__(self, log: Log, world: str, map_style: Mapping[str, Any], way_style: Mapping[str, Any]) -> None:
        """log: (stamp_ns, entity path, archetype). world: the robot's entity. *_style: of points and of lines."""
        self._log, self._world = log, world
        self._map_style, self._way_style = map_style, way_style
        self.poses: dict[int, Array] = {}
        self.points = 0
        self._blocks: dict[int, _Block] = {}
        self._newest: dict[int, Cloud] = {}  # by keyframe
        self._unsettled: dict[int, int] = {}  # blocks with points that are not drawn yet: stamp of the newest

    def shows(self, keyframe: int) -> bool:
        """Its points are there."""
        block = self._blocks.get(keyframe // BLOCK)
        return keyframe in self._newest or (block is not None and keyframe in block.clouds)

    @property
    def without_points(self) -> list[int]:
        """Keyframes whose place is known and whose points are not."""
        return sorted(keyframe for keyframe in self.poses if not self.shows(keyframe))

    def add(self, stamp_ns: int, keyframe: int, cloud: Cloud) -> None:
        """The points of a keyframe that was taken just now; its pose is known."""
        if len(self._newest) == NEWEST:
            self.fold(stamp_ns)
        self.points += len(cloud.points)
        self._newest[keyframe] = cloud
        path = self._newest_path(keyframe)
        self._log(stamp_ns, path, transform(self.poses[keyframe]))
        self._log(stamp_ns, path, self._drawn(cloud.points, cloud.colours))

    def put(self, stamp_ns: int, keyframe: int, cloud: Cloud) -> None:
        """The points of a keyframe that was taken then; its pose is known. Shown with its block, or by `settle`."""
        self.points += len(cloud.points)
        block = self._block(keyframe)
        block.clouds[keyframe] = cloud
        self._unsettled[block.number] = max(stamp_ns, self._unsettled.get(block.number, 0))
        if len(block.clouds) == BLOCK:
            self._draw_map(self._unsettled.pop(block.number), block)

    def settle(self) -> None:
        """No more is `put` for now."""
        for number, stamp_ns in self._unsettled.items():
            self._draw_map(stamp_ns, self._blocks[number])
        self._unsettled.clear()

    def fold(self, stamp_ns: int) -> None:
        """The newest keyframes become part of their blocks."""
        for keyframe, cloud in self._newest.items():
            block = self._block(keyframe)
            block.clouds[keyframe] = cloud
            self._unsettled[block.number] = stamp_ns
        for slot in range(len(self._newest)):
            self._log(stamp_ns, f"{self._world}/map/newest/{slot}", rr.Points3D.from_fields(positions=NO_POINTS))
        self._newest.clear()
        self.settle()

    def thin(self, stamp_ns: int, kept: Callable[[Array, Cloud], Cloud]) -> None:
        """Each keyframe keeps what `kept` leaves of it: (T_map_lidar, cloud) -> cloud."""
        self.fold(stamp_ns)
        self.points = 0
        for block in self._blocks.values():
            for keyframe, cloud in block.clouds.items():
                block.clouds[keyframe] = kept(self.poses[keyframe], cloud)
                self.points += len(block.clouds[keyframe].points)
            self._draw_map(stamp_ns, block)

    def add_way(self, stamp_ns: int, keyframe: int, strips_keyframe: Sequence[Array]) -> None:
        """Pieces of the way, (N, 3) m each, in the frame of a keyframe whose pose is known."""
        block = self._block(keyframe)
        block.ways.setdefault(keyframe, []).extend(strips_keyframe)
        self._draw_way(stamp_ns, block)

    def move(self, stamp_ns: int, poses: Mapping[int, Array]) -> None:
        """Keyframes are there now, or are known now."""
        self.poses.update(poses)
        touched = dict.fromkeys(keyframe // BLOCK for keyframe in poses)
        for block in (self._blocks[number] for number in touched if number in self._blocks):
            if self._is_bent(block):
                block.drawn.clear()
                self._draw_map(stamp_ns, block)
                self._draw_way(stamp_ns, block)
            elif block.drawn:
                self._place(stamp_ns, block)
        for keyframe in self._newest.keys() & poses.keys():
            self._log(stamp_ns, self._newest_path(keyframe), transform(poses[keyframe]))

    # --- what is drawn ----------------------------------------------------------------------------------------

    def _block(self, keyframe: int) -> _Block:
        number = keyframe // BLOCK
        return self._blocks.setdefault(number, _Block(number, keyframe))

    def _newest_path(self, keyframe: int) -> str:
        return f"{self._world}/map/newest/{list(self._newest).index(keyframe)}"

    def _drawn(self, points: Points, colours: Colours) -> rr.Points3D:
        return rr.Points3D(points, colors=colours, **self._map_style)

    def _draw_map(self, stamp_ns: int, block: _Block) -> None:
        if not block.clouds:
            return
        shape = self._shape(block)
        clouds = [(shape[keyframe], cloud) for keyframe, cloud in sorted(block.clouds.items())]
        points = np.concatenate([_moved(T, cloud.points) for T, cloud in clouds])
        colours = np.concatenate([cloud.colours for _, cloud in clouds])
        self._place(stamp_ns, block)
        self._log(block.logged_ns, f"{self._world}/map/{block.number}", self._drawn(points, colours))

    def _draw_way(self, stamp_ns: int, block: _Block) -> None:
        if not block.ways:
            return
        shape = self._shape(block)
        strips = [_moved(shape[keyframe], piece) for keyframe, way in sorted(block.ways.items()) for piece in way]
        self._place(stamp_ns, block)
        drawn = rr.LineStrips3D(strips, **self._way_style)
        self._log(block.logged_ns, f"{self._world}/trajectory/{block.number}", drawn)

    def _place(self, stamp_ns: int, block: _Block) -> None:
        block.logged_ns = max(stamp_ns, block.logged_ns)
        trees = ("map",) * bool(block.clouds) + ("trajectory",) * bool(block.ways)
        for tree in trees:
            self._log(block.logged_ns, f"{self._world}/{tree}/{block.number}", transform(self.poses[block.first]))

    # --- the shape of a block ---------------------------------------------------------------------------------

    def _shape(self, block: _Block) -> dict[int, Array]:
        """T_first_keyframe: as it is drawn, of those that are not yet as it is now."""
        T_first_map = se3.inv(self.poses[block.first])
        for keyframe in block.clouds.keys() | block.ways.keys():
            if keyframe not in block.drawn:
                block.drawn[keyframe] = T_first_map @ self.poses[keyframe]
        return block.drawn

    def _is_bent(self, block: _Block) -> bool:
        T_first_map = se3.inv(self.poses[block.first])
        return any(_off_m(T, T_first_map @ self.poses[keyframe]) > _BENT_M for keyframe, T in block.drawn.items())


def transform(T: Array) -> rr.Transform3D:
    """Of what is under an entity, (4, 4)."""
    return rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3])


def _moved(T: Array, points: NDArray) -> Points:
    return (points @ T[:3, :3].T + T[:3, 3]).astype(np.float32)


def _off_m(T: Array, T_now: Array) -> float:
    """By how much a point within reach may have moved."""
    D = se3.inv(T) @ T_now
    return float(np.linalg.norm(D[:3, 3]) + _REACH_M * np.linalg.norm(se3.so3_log(D[:3, :3])))
