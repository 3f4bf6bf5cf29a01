"""Detections that stay where they belong: python examples/reanchor.py HOST:PORT SESSION_ID

Notes something at each keyframe, as a detector would, and moves it when a correction moves the map.
"""

import sys

import numpy as np

from splitslam.map_client import MapClient, matrix
from splitslam.wire.pose_pb2 import SessionSelection

server, session_id = sys.argv[1:]
seen: dict[int, tuple[int, np.ndarray]] = {}  # stamp_ns -> version of the map, T_map_object
with MapClient(server) as client:
    for news in client.watch_poses(SessionSelection(session_ids=[session_id]), from_start=True):
        for pose in news.poses:
            if pose.keyframe:
                seen[pose.stamp_ns] = pose.map_version, matrix(pose.pose_map_lidar)
        for stamp_ns, (version, T_map_object) in seen.items() if news.HasField("moved") else ():
            then, now = (client.pose_at(session_id, stamp_ns, v) for v in (version, 0))
            delta = matrix(now.pose_map_lidar) @ np.linalg.inv(matrix(then.pose_map_lidar))
            seen[stamp_ns] = now.map_version, delta @ T_map_object
for stamp_ns, (_, T_map_object) in seen.items():
    print(stamp_ns, *T_map_object[:3, 3].round(3))
