from __future__ import annotations

import json
from io import BufferedWriter, FileIO, TextIOWrapper
from pathlib import Path

import numpy as np
import pytest

from edge_agent import _text_kernels as text_kernels
from edge_agent.outputs import Outputs
from edge_agent.types import OdometryReply, OdomPoses
from splitslam import se3
from splitslam.errors import InputError
from splitslam.tum import tum_line
from splitslam.wire import types_pb2 as types


def reply(covariance: np.ndarray | None = None, state: int = types.TRACKING_STATE_TRACKING) -> OdometryReply:
    covariance = np.eye(6) if covariance is None else covariance
    return OdometryReply(1, 17, np.eye(4), np.eye(4), covariance, state, np.zeros((0, 6)))


def test_a_stamp_keeps_its_nanoseconds():
    line = tum_line(1_700_000_000_123_456_789, np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))
    assert line.startswith("1700000000.123456789 0.000000000 ")
    assert tum_line(5, np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0])).startswith("0.000000005 ")


def test_nothing_is_there_before_publish_and_everything_after(tmp_path: Path):
    outputs = Outputs(tmp_path / "a" / "out")
    outputs.online(reply())
    assert [p for p in (tmp_path / "a" / "out").iterdir() if not p.name.startswith(".")] == []
    outputs.publish({"scans": {"read": 1}})
    names = sorted(p.name for p in (tmp_path / "a" / "out").iterdir())
    assert names == ["edge.json", "imu.tum", "metrics.prom", "odom.tum", "online.tum", "online_covariance.csv"]
    assert json.loads((tmp_path / "a" / "out" / "edge.json").read_text()) == {"scans": {"read": 1}}
    outputs.discard()
    assert len(list((tmp_path / "a" / "out").iterdir())) == 6


def test_discard_leaves_no_file_and_no_folder_that_was_not_there(tmp_path: Path):
    outputs = Outputs(tmp_path / "a" / "out")
    outputs.online(reply())
    outputs.discard()
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_does_not_keep_discard_from_what_it_is_for(tmp_path: Path):
    outputs = Outputs(tmp_path / "a" / "out")
    outputs._files["online.tum"].close()
    outputs._files["online.tum"] = TextIOWrapper(BufferedWriter(FileIO("/dev/full", "w")))
    outputs.online(reply())
    outputs.discard()
    assert list(tmp_path.iterdir()) == []


def test_discard_keeps_what_was_there_before(tmp_path: Path):
    (tmp_path / "online.tum").write_text("old")
    Outputs(tmp_path).discard()
    assert [p.name for p in tmp_path.iterdir()] == ["online.tum"]


def test_a_folder_that_cannot_be_is_one_line(tmp_path: Path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=r"output.dir .*file/out"):
        Outputs(tmp_path / "file" / "out")


def test_many_lines_at_once_say_what_one_line_says():
    rng = np.random.default_rng(5)
    stamps_ns = np.concatenate([[0, 5, 1_700_000_000_123_456_789], rng.integers(0, 2**62, 200)])
    positions_m = rng.normal(size=(203, 3)) * 10.0 ** rng.integers(-11, 6, (203, 3))
    positions_m[0] = 0.0, -0.0, -1e-12
    positions_m[1] = 0.9999999999, -9.9999999996, 123456789.0
    quats_xyzw = rng.normal(size=(203, 4))
    text = np.empty(text_kernels.LONGEST_LINE * 203, np.uint8)
    size = text_kernels.tum_lines(stamps_ns, positions_m, quats_xyzw, text)
    expected = [tum_line(*row) for row in zip(stamps_ns, positions_m, quats_xyzw, strict=True)]
    assert bytes(text[:size]).decode().splitlines(keepends=True) == expected


def test_imu_lines_are_the_odom_poses_moved_by_t_map_odom(tmp_path: Path):
    rng = np.random.default_rng(1)
    T_map_odom = se3.exp(rng.normal(size=6))
    T_odom_lidar = [se3.exp(rng.normal(size=6)) for _ in range(3)]
    quats = np.stack([se3.quat_from_matrix(T[:3, :3]) for T in T_odom_lidar])
    positions = np.stack([T[:3, 3] for T in T_odom_lidar])
    outputs = Outputs(tmp_path)
    outputs.imu(OdomPoses(np.array([1, 2, 3]), positions, quats, np.zeros((3, 3))), T_map_odom)
    outputs.publish({})
    rows = np.loadtxt(tmp_path / "imu.tum")
    for row, T in zip(rows, T_odom_lidar, strict=True):
        np.testing.assert_allclose(se3.from_quat(row[1:4], row[4:]), T_map_odom @ T, atol=1e-8)


def test_lines_of_moved_poses_say_what_the_poses_say():
    rng = np.random.default_rng(2)
    T_map_odom, T_odom_lidar = se3.exp(rng.normal(size=6)), [se3.exp(rng.normal(size=6)) for _ in range(20)]
    stamps_ns = np.arange(20) * 2_000_000
    positions_m = np.array([T[:3, 3] for T in T_odom_lidar])
    quats_xyzw = np.array([se3.quat_from_matrix(T[:3, :3]) for T in T_odom_lidar])
    text = np.empty(text_kernels.LONGEST_LINE * 20, np.uint8)
    size = text_kernels.moved_lines(stamps_ns, positions_m, quats_xyzw, T_map_odom, text)
    lines = bytes(text[:size]).decode().splitlines(keepends=True)
    assert len(lines) == 20
    for line, stamp_ns, T in zip(lines, stamps_ns, T_odom_lidar, strict=True):
        stamp, *pose = line.split()
        assert stamp == f"0.{stamp_ns:09d}"
        got = se3.from_quat(np.array(pose[:3], float), np.array(pose[3:], float))
        np.testing.assert_allclose(got, T_map_odom @ T, atol=1e-8)


def test_the_covariance_of_an_answer_can_be_read_back(tmp_path: Path):
    half = np.random.default_rng(3).normal(size=(6, 6))
    covariance = half @ half.T
    outputs = Outputs(tmp_path)
    outputs.online(reply(covariance, types.TRACKING_STATE_DEGENERATE))
    outputs.publish({})
    header, row = (tmp_path / "online_covariance.csv").read_text().splitlines()
    names, fields = header.split(","), row.split(",")
    assert fields[:2] == ["17", "degenerate"]
    assert len(names) == len(fields) == 23
    axes = ["rx", "ry", "rz", "tx", "ty", "tz"]
    for name, value in zip(names[2:], fields[2:], strict=True):
        i, j = (axes.index(axis) for axis in name.split("_"))
        assert float(value) == pytest.approx(covariance[i, j], rel=1e-6)
