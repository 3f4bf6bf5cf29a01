"""VelodyneScan packets: real captures, a real dual-return recording, and packets made by hand."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import velodyne_decoder as vd
from scipy.spatial import KDTree

from edge_agent.sources import open_recording
from edge_agent.sources.beams import MODEL_ELEVATIONS_DEG, elevation_rad
from edge_agent.sources.velodyne import VelodyneDecoder
from splitslam.errors import DataError, InputError
from splitslam.scan import Scan
from tests.sources.robots import robot

T0_NS = 1_700_000_000_000_000_123
VLP16_CODE, HDL32_CODE, DUAL, STRONGEST = 0x22, 0x21, 0x39, 0x37


def message(packets: list[bytes], stamps_ns: list[int]) -> Any:
    """A VelodyneScan as rosbags gives it."""

    def stamp(ns: int) -> Any:
        return SimpleNamespace(sec=ns // 10**9, nanosec=ns % 10**9)

    rows = [
        SimpleNamespace(stamp=stamp(ns), data=np.frombuffer(data, np.uint8))
        for data, ns in zip(packets, stamps_ns, strict=True)
    ]
    return SimpleNamespace(header=SimpleNamespace(stamp=stamp(stamps_ns[0])), packets=rows)


def packet(sensor_us: int, azimuth: int = 0, mode: int = STRONGEST, distances: tuple[int, int] = (2500, 2500)) -> bytes:
    """A VLP-16 packet in which every laser returns; in dual mode the odd blocks are the strongest returns."""
    pairs = 2 if mode == DUAL else 1
    blocks = b"".join(
        b"\xff\xee"
        + ((azimuth + 40 * (block // pairs)) % 36000).to_bytes(2, "little")
        + (distances[block % 2].to_bytes(2, "little") + bytes([10 + 50 * (block % 2)])) * 32
        for block in range(12)
    )
    return blocks + sensor_us.to_bytes(4, "little") + bytes([mode, VLP16_CODE])


def pcap_packets(path: Path) -> list[bytes]:
    with path.open("rb") as file:
        return [bytes(data) for _, data in vd.util.iter_pcap(file) if len(data) == 1206]


def sensor_us(packets: list[bytes]) -> np.ndarray:
    return np.array([int.from_bytes(data[1200:1204], "little") for data in packets])


def test_every_laser_has_the_time_of_the_user_manual():
    # VLP-16 user manual, 9.4: 55.296 us a firing sequence, 2.304 us a laser, in firing order 0 8 1 9 ...
    raw = VelodyneDecoder("vlp16")(message([packet(0), packet(1327, 480)], [T0_NS, T0_NS + 1_327_104]))
    assert raw.stamp_ns == T0_NS
    firing, laser = np.divmod(np.arange(24 * 16), 16)
    one = 55_296 * firing + 2_304 * laser
    assert (raw.t_offset_ns == np.concatenate([one, 1_327_104 + one])).all()
    assert (raw.ring[:16] == np.arange(16).reshape(2, 8).T.reshape(-1)).all()
    assert raw.end_ns == T0_NS + 1_327_104 + int(one[-1])
    assert raw.native_bytes == 2 * 1206


def test_host_stamps_that_jitter_give_way_to_the_sensors_own_clock_also_over_the_full_hour():
    hour = 3_600_000_000
    packets = [packet(hour - 1327), packet(0, 480), packet(1327, 960)]
    raw = VelodyneDecoder("vlp16")(message(packets, [T0_NS, T0_NS + 4_000_000, T0_NS + 4_100_000]))
    starts = raw.t_offset_ns[:: 24 * 16]
    assert starts.tolist() == [0, 1_327_000, 2_654_000]


def test_a_first_packet_without_returns_still_gives_the_reference_time():
    packets = [packet(0, distances=(0, 0)), packet(1327, 480)]
    raw = VelodyneDecoder("vlp16")(message(packets, [T0_NS, T0_NS + 1_327_104]))
    assert raw.stamp_ns == T0_NS
    assert raw.t_offset_ns.min() == 1_327_104


def test_of_two_returns_the_strongest_is_kept():
    packets = [packet(664 * k, 240 * k, DUAL, (4000, 2500)) for k in range(3)]
    raw = VelodyneDecoder("vlp16")(message(packets, [T0_NS + 663_552 * k for k in range(3)]))
    assert len(raw.t_offset_ns) == 3 * 12 * 16
    assert np.linalg.norm(raw.points_lidar, axis=1) == pytest.approx(5.0, abs=0.02)
    assert (raw.intensity == 60).all()
    # the next packet starts one sequence after the last one of this
    assert np.unique(np.diff(np.unique(raw.t_offset_ns))).tolist() == [2_304, 20_736]


def test_decoding_a_message_does_not_depend_on_the_one_before(shared_data):
    packets = pcap_packets(shared_data / "fixtures" / "velodyne" / "vlp16_gps.pcap")
    stamps = (T0_NS + sensor_us(packets) * 1000).tolist()
    one, other = message(packets[:75], stamps[:75]), message(packets[75:150], stamps[75:150])
    decoder = VelodyneDecoder("vlp16")
    decoder(one)
    second, alone = decoder(other), VelodyneDecoder("vlp16")(other)
    assert (second.points_lidar == alone.points_lidar).all()
    assert (second.t_offset_ns == alone.t_offset_ns).all()


def test_a_real_vlp16_capture_has_scans_of_17_to_19_thousand_points(shared_data):
    packets = pcap_packets(shared_data / "fixtures" / "velodyne" / "vlp16_gps.pcap")
    assert len(packets) == 293
    decoder = VelodyneDecoder("vlp16")
    for start in range(0, 219, 73):
        part = packets[start : start + 73]
        raw = decoder(message(part, (T0_NS + sensor_us(part) * 1000).tolist()))
        assert 16_500 < len(raw.points_lidar) < 19_500
        assert (np.diff(raw.t_offset_ns) > 0).all()


def test_a_real_hdl32_capture_has_the_models_elevations(shared_data):
    packets = pcap_packets(shared_data / "fixtures" / "velodyne" / "hdl32.pcap")[:180]
    stamps = (T0_NS + sensor_us(packets) * 1000).tolist()
    raw = VelodyneDecoder("hdl32")(message(packets, stamps))
    assert (np.diff(raw.t_offset_ns) > 0).all()
    horizontal_m = np.hypot(raw.points_lidar[:, 0], raw.points_lidar[:, 1])
    angle_deg = np.rad2deg(elevation_rad(raw.points_lidar))
    for ring in range(32):
        of_ring = (raw.ring == ring) & (horizontal_m > 3)
        if of_ring.any():
            assert np.median(angle_deg[of_ring]) == pytest.approx(MODEL_ELEVATIONS_DEG["hdl32"][ring], abs=0.5)


def test_the_real_dual_return_recording_is_the_reference_cloud(shared_data):
    fixtures = shared_data / "fixtures" / "velodyne"
    reference = read_reference(fixtures / "vlp16_dual_return_reference.pcd")
    lidar = "model: vlp16, min_range_m: 0.1, max_range_m: 300"
    recording = open_recording(fixtures / "vlp16_dual_return_ros2bag", robot(lidar))
    scans = [event for _, event in recording.events() if isinstance(event, Scan)]
    assert len(scans) == 4
    assert recording.robot.imu is None
    scan = scans[3]  # the one the reference was written from
    assert abs(len(scan) - len(reference)) < 0.03 * len(reference)  # it keeps second returns too
    points = np.stack([reference["x"], reference["y"], reference["z"]], axis=1)
    found: tuple[np.ndarray, np.ndarray] = KDTree(points).query(scan.points_lidar)  # type: ignore[assignment]
    distance_m, nearest = found
    # The reference leaves out the lasers' vertical offsets (up to 11 mm) and interpolates the azimuth otherwise.
    assert np.median(distance_m) < 0.008
    assert np.percentile(distance_m, 99) < 0.035
    close = distance_m < 0.01
    assert close.sum() > 10_000
    assert np.mean(scan.ring[close] == reference["channel"][nearest[close]]) > 0.999
    assert all(abs(s.end_ns - s.stamp_ns - 100_000_000) < 1_000_000 for s in scans)


def test_packets_of_another_sensor_than_the_robot_file_says_are_an_error(shared_data):
    bag = shared_data / "fixtures" / "velodyne" / "vlp16_dual_return_ros2bag"
    with pytest.raises(InputError, match=r"packets come from a vlp16, expected lidar.model: vlp16"):
        open_recording(bag, robot("model: hdl32"))


@pytest.mark.parametrize(
    ("packets", "reason"), [([], "empty"), ([b"\0" * 512], "decode")], ids=["no packets", "position packet"]
)
def test_messages_without_data_packets_are_dropped(packets, reason):
    made = message([*packets], [T0_NS] * len(packets)) if packets else message_without_packets()
    with pytest.raises(DataError) as error:
        VelodyneDecoder("vlp16")(made)
    assert error.value.reason == reason


def message_without_packets() -> Any:
    return SimpleNamespace(header=SimpleNamespace(stamp=SimpleNamespace(sec=1, nanosec=0)), packets=[])


def read_reference(path: Path) -> np.ndarray:
    raw = path.read_bytes()
    names = ["x", "y", "z", "intensity", "return_type", "channel", "azimuth", "elevation", "distance", "time_stamp"]
    formats = ["f4", "f4", "f4", "u1", "u1", "u2", "f4", "f4", "f4", "u4"]
    body = raw.index(b"DATA binary\n") + len(b"DATA binary\n")
    return np.frombuffer(raw[body:], np.dtype(list(zip(names, formats, strict=True))), count=14831)
