"""The factor graph as g2o: what pose graph optimisers read."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from splitslam import se3
from splitslam.maps import AntennaFix, Between, MapGraph

Array = NDArray[np.float64]
_NOTHING = 1e-9  # information where a fix says nothing: readers want a matrix that is positive definite
_TRANSLATION_FIRST = [3, 4, 5, 0, 1, 2]


@dataclass(frozen=True, slots=True)
class Written:
    """Lines of each kind; left_out: factors that g2o has no line for."""

    vertices: int
    edges: int
    left_out: dict[str, int]


def write_g2o(path: Path, graph: MapGraph) -> Written:
    """Keyframes as VERTEX_SE3:QUAT (T_map_lidar), odometry and loops as EDGE_SE3:QUAT with their information.

    A datum of GNSS is a vertex T_map_enu, numbered after the keyframes; each of its fixes an edge to the keyframe:
    where its lidar is in `enu`, with the antenna's lever arm turned as the keyframe is now and the fix's information on
    the translation alone. Robust kernels have no place in g2o. Keyframe 0 is fixed.
    """
    with path.open("w", encoding="ascii") as file:
        for i, T in enumerate(graph.T_map_lidar):
            file.write(f"VERTEX_SE3:QUAT {i} {_pose(T)}\n")
        for datum, T_enu_map in sorted(graph.T_enu_map.items()):
            file.write(f"VERTEX_SE3:QUAT {datum_id(graph, datum)} {_pose(se3.inv(T_enu_map))}\n")
        file.write("FIX 0\n")
        for between in graph.betweens:
            file.write(_edge(between.older, between.newer, between.T_older_newer, _information(between)))
        for fix in graph.fixes:
            T_enu_lidar, information = _position(fix, graph)
            file.write(_edge(datum_id(graph, fix.datum), fix.keyframe, T_enu_lidar, information))
    vertices = len(graph.T_map_lidar) + len(graph.T_enu_map)
    return Written(vertices, len(graph.betweens) + len(graph.fixes), graph.others)


def datum_id(graph: MapGraph, datum: int) -> int:
    """The vertex of a datum."""
    return len(graph.T_map_lidar) + datum


def _information(between: Between) -> Array:
    """(6, 6) in g2o's order, translation first.

    g2o's error is the translation and the vector part of the quaternion, half the rotation vector; gtsam, Ceres and
    most others read the rotation's information as that of the rotation vector, and so it is written.
    """
    information = np.linalg.inv(between.covariance)[np.ix_(_TRANSLATION_FIRST, _TRANSLATION_FIRST)]
    return information.astype(np.float64)


def _position(fix: AntennaFix, graph: MapGraph) -> tuple[Array, Array]:
    """T_enu_lidar as the fix measures it, and its information (6, 6) in the frame of that pose."""
    R = (graph.T_enu_map[fix.datum] @ graph.T_map_lidar[fix.keyframe])[:3, :3]
    information = np.eye(6) * _NOTHING
    information[:3, :3] = R.T @ np.diag(1.0 / fix.sigmas_m**2) @ R
    return se3.compose(R, fix.enu_m - R @ fix.antenna_keyframe), information


def _edge(first: int, second: int, T: Array, information: Array) -> str:
    upper = " ".join(f"{value:.12g}" for value in information[np.triu_indices(6)].tolist())
    return f"EDGE_SE3:QUAT {first} {second} {_pose(T)} {upper}\n"


def _pose(T: Array) -> str:
    return " ".join(f"{value:.12g}" for value in [*T[:3, 3].tolist(), *se3.quat_from_matrix(T[:3, :3]).tolist()])
