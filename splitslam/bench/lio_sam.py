"""What LIO-SAM's nodes would send: its features by its rules, and the bytes of its messages.

Sizes count what the fields hold, as the paper does in Table III: its raw points are 18 B (xyz and time float32, ring
uint16), so are those here, and clouds have no intensity. `ros_bytes` is what ROS serialises for the same messages.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from edge_agent.features import _kernels as kernels
from edge_agent.features._thinning_kernels import thin_surfs
from edge_agent.features.integer import RANGE_UNITS_PER_M, FeatureMarks, Limits
from edge_agent.features.projection import Image
from edge_agent.settings import FeatureSettings

# config/params.yaml: edgeThreshold, surfThreshold, odometrySurfLeafSize; featureExtraction.cpp: 20 corners, 6 sectors.
SETTINGS = FeatureSettings(
    corner_threshold_m2=1.0, surf_threshold_m2=0.1, corners_per_sector=20, sectors=6, surf_leaf_m=0.4
)

RAW_POINT = np.dtype([("xyz", "<f4", 3), ("ring", "<u2"), ("time", "<f4")])  # 18 B: RAW_POINT_BYTES
XYZ_BYTES, RANGE_BYTES, COLUMN_BYTES = 12, 4, 4  # float32 x 3; cloud_info's float32 pointRange, int32 pointColInd
_HEADER_BYTES = 4 + 8 + 4 + len("base_link")  # std_msgs/Header: seq, stamp, frame_id
_SCALAR_BYTES = 2 * 8 + 9 * 4  # imuAvailable, odomAvailable; three initial angles, six of the initial guess
_RING_INDEX_BYTES = 2 * 4  # int32 startRingIndex, endRingIndex
_ARRAYS_BYTES = 4 * 4  # the lengths of the four arrays
# sensor_msgs/PointCloud2: size, four field descriptions (x y z, intensity), flags and steps; PointXYZI is padded.
_CLOUD_BYTES = _HEADER_BYTES + 8 + (4 + 3 * 14 + 22) + 1 + 4 + 4 + 4 + 1
_EMPTY_CLOUD_BYTES = (_HEADER_BYTES - len("base_link")) + 8 + 4 + 1 + 4 + 4 + 4 + 1
_XYZI_BYTES = 32
_CLOUDS = 7  # deskewed, corner, surface, four of keyframes


class LioSamFeatures:
    """LIO-SAM's Feature node: at most 20 corners a sector, all other points thinned to a voxel of 0.4 m a ring."""

    def __init__(self, rings: int, columns: int) -> None:
        cells = rings * columns
        self.limits = Limits.of(SETTINGS)
        self._picked, self._rank = np.empty(cells, np.uint8), np.empty(cells, np.uint8)
        self._surfs = np.empty(cells, np.int32)
        slots = 1 << (2 * columns - 1).bit_length()
        self._table, self._sums = np.empty((slots, 2), np.int64), np.empty((columns, 6))

    def select(
        self,
        image: Image,
        marks: FeatureMarks,
        leaf_m: float = SETTINGS.surf_leaf_m,
        corners_per_sector: int = SETTINGS.corners_per_sector,
    ) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Rows of the image's corners and surfs. image: deskewed points. marks: made with `limits`."""
        n = len(image)
        picked, rank = self._picked[:n], self._rank[:n]
        kernels.select_corners(
            marks.d, marks.marks, image.column, picked, image.ring_start, SETTINGS.sectors, corners_per_sector, rank
        )
        count = thin_surfs(image.points_lidar, rank, image.ring_start, leaf_m, self._table, self._sums, self._surfs)
        return np.flatnonzero(rank), self._surfs[:count].astype(np.intp)


def raw_message(points_lidar: NDArray[np.float32], ring: NDArray[np.uint8], t_offset_ns: NDArray[np.int32]) -> bytes:
    """Case 1, one scan without its IMU messages: 18 B a point."""
    packed = np.empty(len(ring), RAW_POINT)
    packed["xyz"], packed["ring"], packed["time"] = points_lidar, ring, t_offset_ns * np.float32(1e-9)
    return packed.tobytes()


def deskewed_message(image: Image) -> bytes:
    """Case 2, cloud_info after the Image node: deskewed points, ranges and columns, the rings' ends."""
    rings = len(image.ring_start) - 1
    assert image.range_q is not None
    fixed = bytes(_HEADER_BYTES + _SCALAR_BYTES + _ARRAYS_BYTES + _RING_INDEX_BYTES * rings)
    range_m = image.range_q.astype(np.float32) * np.float32(1.0 / RANGE_UNITS_PER_M)
    return b"".join((fixed, image.points_lidar.tobytes(), range_m.tobytes(), image.column.astype("<i4").tobytes()))


def feature_message(image: Image, corners: NDArray[np.intp], surfs: NDArray[np.intp]) -> bytes:
    """Case 3, cloud_info after the Feature node: the arrays are empty, two clouds of features are full."""
    points = image.points_lidar
    return b"".join((bytes(_HEADER_BYTES + _SCALAR_BYTES), points[corners].tobytes(), points[surfs].tobytes()))


def ros_bytes(rings: int, columns: int, deskewed: int, features: int | None = None) -> int:
    """The serialised cloud_info: of Case 2, or of Case 3 when `features` (their number) is given.

    Ranges and columns have the image's full length whatever is valid; PointXYZI takes 32 B; after the Feature node
    the arrays are empty, but the deskewed cloud is still inside, for display.
    """
    arrays = _RING_INDEX_BYTES * rings + (RANGE_BYTES + COLUMN_BYTES) * rings * columns
    full, points = (1, deskewed) if features is None else (3, deskewed + features)
    clouds = full * _CLOUD_BYTES + (_CLOUDS - full) * _EMPTY_CLOUD_BYTES + _XYZI_BYTES * points
    return _HEADER_BYTES + _SCALAR_BYTES + _ARRAYS_BYTES + (arrays if features is None else 0) + clouds
