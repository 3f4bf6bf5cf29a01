"""A map's graph as messages; splitslam/export/server_source.py reads them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TypeVar

from map_service.messages import transform_to_wire
from splitslam.maps import AntennaFix, Between, MapGraph
from splitslam.wire import session_pb2 as pb

_AT_ONCE = 1000
T = TypeVar("T")


def graph_to_wire(graph: MapGraph) -> Iterator[pb.PoseGraphResponse]:
    """Messages of at most 1,000 entries each; the first says where `enu` is."""
    data = [pb.GraphDatum(datum=d, pose_enu_map=transform_to_wire(E)) for d, E in graph.T_enu_map.items()]
    first = pb.PoseGraphResponse(data=data, others=graph.others)
    if graph.origin is not None:
        latitude_deg, longitude_deg, altitude_m = graph.origin
        first.origin.latitude_deg = latitude_deg
        first.origin.longitude_deg = longitude_deg
        first.origin.altitude_m = altitude_m
    yield first
    rows = list(zip(graph.stamps_ns.tolist(), graph.T_map_lidar, strict=True))
    for start, page in _pages(rows):
        yield pb.PoseGraphResponse(
            keyframes=[
                pb.GraphKeyframe(keyframe=start + i, stamp_ns=ns, pose_map_lidar=transform_to_wire(pose))
                for i, (ns, pose) in enumerate(page)
            ]
        )
    for _, page in _pages(graph.betweens):
        yield pb.PoseGraphResponse(edges=map(_edge, page))
    for _, page in _pages(graph.fixes):
        yield pb.PoseGraphResponse(fixes=map(_fix, page))


def _pages(rows: Sequence[T]) -> Iterator[tuple[int, Sequence[T]]]:
    for start in range(0, len(rows), _AT_ONCE):
        yield start, rows[start : start + _AT_ONCE]


def _edge(between: Between) -> pb.GraphEdge:
    return pb.GraphEdge(
        kind=between.kind,
        older=between.older,
        newer=between.newer,
        pose_older_newer=transform_to_wire(between.T_older_newer),
        covariance=between.covariance.ravel().tolist(),
        robust=between.robust,
    )


def _fix(fix: AntennaFix) -> pb.GraphFix:
    return pb.GraphFix(
        keyframe=fix.keyframe,
        antenna_keyframe_m=fix.antenna_keyframe.tolist(),
        enu_m=fix.enu_m.tolist(),
        sigmas_m=fix.sigmas_m.tolist(),
        datum=fix.datum,
    )
