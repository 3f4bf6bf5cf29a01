"""Real captures sent over the wire: every packet is decoded or counted, and the points are the reference decoder's."""

from __future__ import annotations

import hashlib
import json
import socket
import struct
import sys
from collections import Counter
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import ouster.sdk.core
import pytest
import velodyne_decoder as vd

from edge_agent.sources import Counts
from edge_agent.sources.live import clock
from edge_agent.sources.live import source as source_module
from edge_agent.sources.live.clock import RunClock
from edge_agent.sources.live.opening import open_live
from edge_agent.sources.live.ouster import open_ouster
from edge_agent.sources.live.sensor_clock import SensorClock
from edge_agent.sources.live.turns import PACKET_BYTES
from splitslam.errors import InputError
from splitslam.pcap import Datagram, datagrams
from splitslam.replay import Faults, send, with_faults
from splitslam.robot import Robot
from splitslam.scan import ImuSamples, Scan
from tests.live import wire

DATA_PORT, POSITION_PORT = 2368, 8308
MODELS = {"vlp16": vd.Model.VLP16, "hdl32": vd.Model.HDL32E}
CAPTURES = {"vlp16": "vlp16_gps.pcap", "hdl32": "hdl32.pcap"}


@pytest.fixture(autouse=True)
def _captures_are_short(monkeypatch: pytest.MonkeyPatch) -> None:
    """No more comes that would tell the clock: what has come must do, and soon."""
    monkeypatch.setattr(clock, "_PATIENCE_NS", 300_000_000)


def velodyne_run(model: str, packets: list[Datagram], speed: float | None = 1.0) -> wire.Listener:
    """The packets sent to a source; what it made of them."""
    with wire.listening(wire.velodyne_robot(model), wire.config()) as listener:
        position, data = wire.ports_of(listener.source)
        send(packets, "127.0.0.1", {DATA_PORT: data, POSITION_PORT: position}, speed)
        listener.until(lambda: len(listener.of(Scan)) > 0)
        listener.until_quiet(0.3)
    return listener


def capture(model: str, shared_data: Path) -> list[Datagram]:
    return list(datagrams(shared_data / "fixtures/velodyne" / CAPTURES[model]))


def reference_scans(model: str, path: Path) -> list[Any]:
    """The decoder's own reading of the file, cut at azimuth 0: its structured points."""
    config = vd.Config(model=MODELS[model], min_range=0.0, max_range=1000.0, timestamp_first_packet=True, cut_angle=0.0)
    return [points for _, points in vd.read_pcap(str(path), config, as_pcl_structs=True)]


@pytest.mark.parametrize("model", ["vlp16", "hdl32"])
def test_every_packet_of_a_velodyne_is_decoded_or_counted_and_the_points_are_the_decoders(
    model: str, shared_data: Path
):
    packets = capture(model, shared_data)
    listener = velodyne_run(model, packets)
    found = wire.counts(listener.source, "lidar")
    scans = listener.of(Scan)
    assert found["used"] + found["start"] == len(packets)
    assert set(found) == {"used", "start"}
    reference = reference_scans(model, shared_data / "fixtures/velodyne" / CAPTURES[model])[1:]  # the first is a piece
    # A wrap that falls between two packets ends our turn there, the decoder's one packet later: all turns on end.
    points = np.concatenate(reference)
    np.testing.assert_array_equal(
        np.concatenate([scan.points_lidar for scan in scans]), np.stack([points[axis] for axis in "xyz"], axis=1)
    )
    np.testing.assert_array_equal(np.concatenate([scan.ring for scan in scans]), points["ring"])
    assert len(scans) == len(reference)
    data = [packet for packet in packets if packet.port == DATA_PORT]
    assert listener.source.counts.native_bytes == PACKET_BYTES * (len(data) - found["start"])


def test_a_locked_velodyne_stamps_in_utc_of_its_sentences_and_in_its_own_microseconds(shared_data: Path):
    packets = capture("vlp16", shared_data)
    listener = velodyne_run("vlp16", packets)
    assert listener.source.clocks.clock("lidar").chosen == "gps"
    sentence = next(p for p in packets if p.port == POSITION_PORT).data[206:].decode("ascii", "ignore").split(",")
    utc = datetime.strptime(f"{sentence[9]} {sentence[1]}", "%d%m%y %H%M%S.%f").replace(tzinfo=UTC)
    microseconds = {int.from_bytes(p.data[1200:1204], "little") for p in packets if p.port == DATA_PORT}
    for scan in listener.of(Scan):
        assert abs(scan.stamp_ns * 1e-9 - utc.timestamp()) < 2.0
        assert scan.stamp_ns // 1000 % 3_600_000_000 in microseconds


@pytest.mark.parametrize("seed", [1, 2])
def test_on_a_bad_network_whatever_comes_is_used_once_and_what_does_not_is_counted(seed: int, shared_data: Path):
    done: Counter[str] = Counter()
    data = [packet for packet in capture("vlp16", shared_data) if packet.port == DATA_PORT]
    sent = list(with_faults(data, Faults(lost=0.1, twice=0.05, late=0.1, seed=seed), done))
    listener = velodyne_run("vlp16", sent)
    found = wire.counts(listener.source, "lidar")
    assert min(done.values()) > 5
    assert found["used"] + found["start"] == len(data) - done["lost"]
    assert found["duplicate"] == done["twice"]
    inside = done["lost"] - found["lost"]  # those before the first and after the last are not known to be lost
    assert 0 <= inside <= 2
    assert found["reordered"] <= done["late"]
    assert sum(map(len, listener.of(Scan))) > 0.8 * 50_000


# --- Ouster -----------------------------------------------------------------------------------------------------------

core: Any = ouster.sdk.core
OS32, OS128 = "OS-1-32-G_v2.1.1_1024x10", "OS-1-128_v2.3.0_1024x10_lb_n3"
LIDAR_PORT, IMU_PORT = 7502, 7503


def ouster_robot(name: str, shared_data: Path, tmp_path: Path, **sections: str) -> Robot:
    return wire.ouster_robot(shared_data / f"fixtures/ouster/{name}.json", tmp_path, **sections)


def ouster_packets(name: str, shared_data: Path) -> list[Datagram]:
    return list(datagrams(shared_data / f"fixtures/ouster/{name}.pcap"))


def ouster_run(robot: Robot, packets: list[Datagram]) -> wire.Listener:
    """The packets sent to a source; what it made of them."""
    with wire.listening(robot, wire.config()) as listener:
        ports: dict[int, int] = dict(zip((LIDAR_PORT, IMU_PORT), wire.ports_of(listener.source), strict=False))
        send([packet for packet in packets if packet.port in ports], "127.0.0.1", ports)
        listener.until(lambda: len(listener.of(Scan)) > 0)
        listener.until_quiet(0.3)
    return listener


def sdk_frames(name: str, packets: list[Datagram], shared_data: Path) -> list[tuple[Any, Any]]:
    """ouster-sdk's own frames of the packets, and where their points are, (rings, columns, 3) float64."""
    info = core.SensorInfo((shared_data / f"fixtures/ouster/{name}.json").read_text())
    batcher, lut, form = core.FrameBatcher(info), core.XYZLut(info, False), core.PacketFormat(info)
    frames, frame = [], core.LidarFrame(info)
    for data in (packet.data for packet in packets if packet.port == LIDAR_PORT):
        packet = core.LidarPacket(form)
        packet.buf[:] = np.frombuffer(data, np.uint8)
        if batcher.batch(packet, frame):
            frames.append(frame)
            frame = core.LidarFrame(info)
            batcher.batch(packet, frame)
    frames.append(frame)
    return [(frame, np.asarray(lut(frame))) for frame in frames]


@pytest.mark.parametrize("name", [OS32, OS128])
def test_every_packet_of_an_ouster_is_decoded_and_the_points_are_the_sdks(name: str, shared_data: Path, tmp_path: Path):
    packets = ouster_packets(name, shared_data)
    listener = ouster_run(ouster_robot(name, shared_data, tmp_path, T_lidar_imu=str(np.eye(4).tolist())), packets)
    scans = listener.of(Scan)
    assert wire.counts(listener.source, "lidar") == {"used": sum(p.port == LIDAR_PORT for p in packets)}
    reference = sdk_frames(name, packets, shared_data)
    assert len(scans) == len(reference)
    for scan, (frame, xyz) in zip(scans, reference, strict=True):
        column, ring = np.nonzero(frame.field("RANGE").T)
        np.testing.assert_array_equal(scan.points_lidar, xyz[ring, column].astype(np.float32))
        np.testing.assert_array_equal(scan.ring, ring)
        stamps_ns = frame.timestamp.astype(np.int64)
        np.testing.assert_array_equal(scan.t_offset_ns, stamps_ns[column] - stamps_ns.min())
        np.testing.assert_array_equal(scan.intensity, frame.field("REFLECTIVITY")[ring, column])
        assert scan.end_ns - scan.stamp_ns == stamps_ns.max() - stamps_ns.min()


def test_decoded_fields_are_those_of_the_makers_digest(shared_data: Path, tmp_path: Path):
    packets = ouster_packets(OS32, shared_data)
    robot = ouster_robot(OS32, shared_data, tmp_path, imu="null")
    sensor = open_ouster(robot, RunClock("auto", 0.05, ()).clock("lidar"), Counts(), Counter())
    columns = [sensor.lidar.parser.columns_of(packet.data) for packet in packets]
    digest = json.loads((shared_data / f"fixtures/ouster/{OS32}_digest.json").read_text())["packet_hash"]
    for key, dtype, arrays in (
        ("TIMESTAMP", np.uint64, [one.stamps_ns for one in columns]),
        ("MEASUREMENT_ID", np.uint16, [one.place for one in columns]),
        ("RANGE", np.uint32, [one.range_mm for one in columns]),
        ("REFLECTIVITY", np.uint8, [one.reflectivity for one in columns]),
    ):
        assert hashlib.md5(b"".join(a.astype(dtype).tobytes() for a in arrays)).hexdigest() == digest[key], key


def test_an_ousters_own_imu_is_in_si_at_its_own_rate_and_sits_where_the_metadata_says(
    shared_data: Path, tmp_path: Path
):
    packets = ouster_packets(OS128, shared_data)
    listener = ouster_run(ouster_robot(OS128, shared_data, tmp_path), packets)
    samples = ImuSamples.joined(listener.of(ImuSamples))
    assert wire.counts(listener.source, "imu") == {"used": 30}
    # An IMU packet as the hardware manual lays it out: three times, accelerations in g, rates in deg/s.
    raw = [struct.unpack("<3Q6f", packet.data) for packet in packets if packet.port == IMU_PORT]
    np.testing.assert_allclose(samples.accel_mps2, np.array([row[3:6] for row in raw]) * 9.80665)
    np.testing.assert_allclose(samples.gyro_radps, np.deg2rad([row[6:9] for row in raw]))
    np.testing.assert_array_equal(np.diff(samples.stamps_ns), np.diff([row[2] for row in raw]))
    assert np.diff(samples.stamps_ns).mean() == pytest.approx(10_000_000, rel=0.01)
    np.testing.assert_allclose(listener.source.robot.T_lidar_imu[:3, 3], [0.006253, -0.011775, 0.007645], atol=1e-9)
    scans = listener.of(Scan)
    assert scans[0].stamp_ns - 20_000_000 < samples.stamps_ns[0] < scans[-1].end_ns  # one clock


def test_an_ousters_imu_packet_of_a_time_beyond_64_bits_is_counted(shared_data: Path, tmp_path: Path):
    dropped: Counter[str] = Counter()
    robot = ouster_robot(OS128, shared_data, tmp_path)
    feed = open_ouster(robot, SensorClock("lidar"), Counts(), dropped).imu
    packet = next(packet for packet in ouster_packets(OS128, shared_data) if packet.port == IMU_PORT).data
    assert not list(feed.take(struct.pack("<3Q", *(2**64 - 1,) * 3) + packet[24:], 10**18))
    assert dropped == {"imu_time_jump": 1}
    assert len(list(feed.take(packet, 10**18))) == 1


def test_what_waits_for_a_clock_that_nobody_tells_does_not_pile_up(
    shared_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """LiDAR packets of another profile than the metadata's: the IMU's alone are understood."""
    monkeypatch.setattr(source_module, "_HELD_NS", 300_000_000)
    data = [packet.data for packet in ouster_packets(OS128, shared_data) if packet.port == IMU_PORT]
    with wire.listening(ouster_robot(OS128, shared_data, tmp_path), wire.config()) as listener:
        port = wire.ports_of(listener.source)[1]
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
            for packet in data:
                out.sendto(packet, ("127.0.0.1", port))
        listener.until(lambda: listener.source.dropped["clock_unknown"] == len(data))
    assert not listener.heard


@pytest.mark.parametrize("seed", [1, 2])
def test_an_ousters_packets_may_be_lost_late_and_twice(seed: int, shared_data: Path, tmp_path: Path):
    robot = ouster_robot(OS128, shared_data, tmp_path, imu="null")
    data = [packet for packet in ouster_packets(OS128, shared_data) if packet.port == LIDAR_PORT]
    done: Counter[str] = Counter()
    sent = list(with_faults(data[1:-1], Faults(lost=0.1, twice=0.05, late=0.1, seed=seed), done))
    found = wire.counts(ouster_run(robot, [data[0], *sent, data[-1]]).source, "lidar")
    assert found["used"] == len(data) - done["lost"]
    assert found["lost"] == done["lost"]
    assert found["duplicate"] + found.get("late", 0) == done["twice"]


def test_a_stream_that_starts_within_a_frame_leaves_that_frame_out(shared_data: Path, tmp_path: Path):
    robot = ouster_robot(OS128, shared_data, tmp_path, imu="null")
    data = [packet for packet in ouster_packets(OS128, shared_data) if packet.port == LIDAR_PORT]
    listener = ouster_run(robot, data[20:])
    assert wire.counts(listener.source, "lidar") == {"start": 44, "used": 128}
    assert len(listener.of(Scan)) == 2


def test_without_the_sdk_one_line_says_how_to_get_it(
    shared_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setitem(sys.modules, "ouster.sdk", None)
    with pytest.raises(InputError, match="expected: pip install --no-deps ouster-sdk"):
        open_live(wire.config(), ouster_robot(OS32, shared_data, tmp_path))


def test_metadata_that_is_none_is_one_line(tmp_path: Path):
    (tmp_path / "os.json").write_text('{"beam_altitude_angles": [1.0, 2.0], "lidar_mode": "1024x10"}')
    with pytest.raises(InputError, match="not Ouster metadata"):
        open_live(wire.config(), wire.ouster_robot(tmp_path / "os.json", tmp_path))
