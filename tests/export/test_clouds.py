"""Every cloud format is read by a library that has not written it, and holds the very points."""

from __future__ import annotations

import importlib
import io
import struct
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pyproj
import pytest
from scipy.spatial import KDTree

from splitslam import se3
from splitslam.errors import InputError
from splitslam.export.command import cloud_writer
from splitslam.export.gps_time import adjusted_gps_s
from splitslam.export.placing import InMap, InUtm, Placing
from splitslam.maps import MapPiece
from tests.export.made import CHILE, YOKOHAMA, joined, pieces
from tests.tolerances import EXPORT_FLOAT32_M, EXPORT_STEP_M, EXPORT_TIME_S

PLACINGS = {"map": InMap, "utm": lambda: InUtm(YOKOHAMA)}
MADE = pieces()


def read_ply(path: Path) -> tuple[np.ndarray, np.ndarray]:
    import plyfile

    ply = plyfile.PlyData.read(path)
    (offset,) = [line.split()[1:] for line in ply.comments if line.startswith("offset ")]
    vertex = ply["vertex"]
    xyz = np.column_stack([vertex[axis] for axis in "xyz"]).astype(np.float64) + np.array(offset, float)
    return xyz, np.column_stack([vertex["intensity"]])


def read_pcd(path: Path) -> tuple[np.ndarray, np.ndarray]:
    from pypcd4.pypcd4 import PointCloud

    points = PointCloud.from_path(path).numpy().astype(np.float64)
    text = path.read_bytes().split(b"\n", 2)[1].decode()
    offset = np.array(text.split("; offset ")[1].split(";")[0].split(), float)
    return points[:, :3] + offset, points[:, 3:]


def read_las(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """By the tables of the LAS 1.4 specification (R15), point format 6, without a library."""
    data = path.read_bytes()
    assert data[:4] == b"LASF"
    assert (data[24], data[25], data[104]) == (1, 4, 6)
    start, size = struct.unpack_from("<I", data, 96)[0], struct.unpack_from("<H", data, 105)[0]
    scale, offset = (np.array(struct.unpack_from("<3d", data, at)) for at in (131, 155))
    x1, x0, y1, y0, z1, z0 = struct.unpack_from("<6d", data, 179)
    (count,) = struct.unpack_from("<Q", data, 247)
    rows = [struct.unpack_from("<3iH", data, start + k * size) for k in range(count)]
    times = [struct.unpack_from("<d", data, start + k * size + 22)[0] for k in range(count)]
    assert len(data) == start + count * size
    xyz = np.array([row[:3] for row in rows]) * scale + offset
    np.testing.assert_allclose([xyz.min(0), xyz.max(0)], [[x0, y0, z0], [x1, y1, z1]], atol=EXPORT_STEP_M)
    return xyz, np.column_stack([[row[3] / 256 for row in rows], times])


def read_laz(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """By LASzip itself; written by lazrs."""
    return _las_columns(laspy.read(path, laz_backend=laspy.LazBackend.Laszip))


def read_copc(path: Path) -> tuple[np.ndarray, np.ndarray]:
    with laspy.CopcReader.open(path) as reader:
        points = reader.query()
    return _las_columns(points)


def read_e57(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """By the Rust crate e57; written by libE57Format."""
    e57: Any = importlib.import_module("e57")  # compiled, without type information
    data = e57.read_points(str(path))
    return np.asarray(data.points, np.float64), np.asarray(data.intensity, np.float64).reshape(-1, 1)


def _las_columns(points: Any) -> tuple[np.ndarray, np.ndarray]:
    xyz = np.column_stack([points.x, points.y, points.z])
    return xyz, np.column_stack([np.asarray(points.intensity) / 256, points.gps_time])


READERS = {"ply": read_ply, "pcd": read_pcd, "las": read_las, "laz": read_laz, "copc": read_copc, "e57": read_e57}
PRECISION_M = {"ply": EXPORT_FLOAT32_M, "pcd": EXPORT_FLOAT32_M}


def write(name: str, path: Path, placing: Placing, made: list[MapPiece] = MADE) -> int:
    return cloud_writer(name)(path, iter(made), placing, "robot/run")


@pytest.mark.parametrize("frame", PLACINGS)
@pytest.mark.parametrize("name", READERS)
def test_another_reader_finds_the_very_points(name: str, frame: str, tmp_path: Path) -> None:
    path, placing = tmp_path / f"map.{name}", PLACINGS[frame]()
    expected = joined(MADE)
    assert write(name, path, placing) == len(expected)
    xyz, others = READERS[name](path)
    if others.shape[1] == 2:  # with times, each of which is one of the keyframes'
        seconds = adjusted_gps_s(np.array([piece.stamp_ns for piece in MADE]))
        keyframe = np.abs(others[:, 1:] - seconds).argmin(axis=1)
        np.testing.assert_allclose(others[:, 1], seconds[keyframe], atol=EXPORT_TIME_S)
        others[:, 1] = keyframe
    expected = np.column_stack([placing.place(expected[:, :3]), expected[:, 3 : 3 + others.shape[1]]])
    off_m = paired(expected, np.column_stack([xyz, others]))
    assert np.abs(off_m).max() <= PRECISION_M.get(name, EXPORT_STEP_M)


def paired(expected: np.ndarray, found: np.ndarray) -> np.ndarray:
    """(N, 3): each expected point's distance along the axes to the one found that is it, its other columns too."""
    apart = np.append(np.ones(3), np.full(expected.shape[1] - 3, 1e3))
    _, at = KDTree(found * apart).query(expected * apart)
    assert len(np.unique(at)) == len(found) == len(expected)
    np.testing.assert_array_equal(found[at, 3:], expected[:, 3:])
    return found[at, :3] - expected[:, :3]


@pytest.mark.parametrize("name", READERS)
def test_a_map_without_points_is_a_file_without_points(name: str, tmp_path: Path) -> None:
    path = tmp_path / f"map.{name}"
    assert write(name, path, InMap(), []) == 0
    if name not in ("laz", "copc", "e57"):  # whose other readers do not take empty files
        xyz, _ = READERS[name](path) if name != "las" else (laspy.read(path).xyz, None)
        assert len(xyz) == 0


@pytest.mark.parametrize("name", ["las", "laz", "copc"])
def test_a_las_file_says_where_on_earth_it_is(name: str, tmp_path: Path) -> None:
    path = tmp_path / "map.laz"
    write(name, path, InUtm(CHILE))
    with laspy.open(path) as file:
        header = file.header
    crs = header.parse_crs()
    assert crs is not None
    assert crs.to_epsg() == 32719
    assert header.global_encoding.wkt
    # the origin of enu, by way of the file's own reference system
    to_utm = pyproj.Transformer.from_crs("EPSG:4326", crs)
    expected = np.array(to_utm.transform(CHILE.latitude_deg, CHILE.longitude_deg))
    origin_map = se3.inv(CHILE.T_enu_map)[:3, 3]
    np.testing.assert_allclose(InUtm(CHILE).place(origin_map[None])[0], [*expected, CHILE.altitude_m], atol=1e-6)


def test_an_e57_file_says_where_on_earth_it_is(tmp_path: Path) -> None:
    import pye57

    path = tmp_path / "map.e57"
    write("e57", path, InUtm(YOKOHAMA))
    with pye57.E57(str(path)) as file:
        assert pyproj.CRS.from_wkt(file.root["coordinateMetadata"].value()).to_epsg() == 32654
        header = file.get_header(0)
        np.testing.assert_allclose(header.translation, InUtm(YOKOHAMA).offset_m)
        stamps_s = adjusted_gps_s(np.array([MADE[0].stamp_ns])) + 1e9
        assert abs(header["acquisitionStart"]["dateTimeValue"].value() - stamps_s[0]) <= EXPORT_TIME_S


@pytest.mark.parametrize("name", ["las", "e57"])
def test_a_point_beyond_the_steps_is_an_input_error(name: str, tmp_path: Path) -> None:
    far = MapPiece(0, 1, np.eye(4), np.array([[3e5, 0, 0, 1]], "<f4"))
    with pytest.raises(InputError, match="214 km"):
        write(name, tmp_path / "map", InMap(), [far])


def test_an_octree_s_file_is_a_laz_file_for_those_who_know_no_octrees(tmp_path: Path) -> None:
    path = tmp_path / "map.copc.laz"
    write("copc", path, InMap())
    plain = laspy.read(io.BytesIO(path.read_bytes()), laz_backend=laspy.LazBackend.Laszip)
    assert len(plain.points) == len(joined(MADE))


def test_the_ends_of_the_earth_have_no_utm() -> None:
    from dataclasses import replace

    with pytest.raises(InputError, match="UTM"):
        InUtm(replace(YOKOHAMA, latitude_deg=88.0))


@pytest.mark.parametrize("name", ["Müllhalde 東", "two\nelement vertex 5\nlines"], ids=["letters", "lines"])
@pytest.mark.parametrize(("kind", "read"), [("ply", read_ply), ("pcd", read_pcd)])
def test_a_run_of_any_name_is_written_into_a_header_of_ascii_lines(name: str, kind: str, read: Any, tmp_path: Path):
    """The folder of a run is called what its owner likes."""
    path = tmp_path / f"map.{kind}"
    count = cloud_writer(kind)(path, iter(MADE), InMap(), name)
    assert len(read(path)[0]) == count
