"""Real captures sent over the wire: every packet is decoded or counted, and the points are the reference decoder's."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import velodyne_decoder as vd

from edge_agent.sources.live.turns import PACKET_BYTES
from splitslam.pcap import Datagram, datagrams
from splitslam.replay import Faults, send, with_faults
from splitslam.scan import ImuSamples, Scan
from tests.live import wire

DATA_PORT, POSITION_PORT = 2368, 8308
MODELS = {"vlp16": vd.Model.VLP16, "hdl32": vd.Model.HDL32E}
CAPTURES = {"vlp16": "vlp16_gps.pcap", "hdl32": "hdl32.pcap"}


def velodyne_run(model: str, packets: list[Datagram], speed: float | None = 1.0) -> wire.Listener:
    """The packets sent to a source; what it made of them."""
    with wire.listening(wire.velodyne_robot(model), wire.config()) as listener:
        position, data = wire.ports_of(listener.source)
        send(packets, "127.0.0.1", {DATA_PORT: data, POSITION_PORT: position}, speed)
        listener.until(lambda: len(listener.of(Scan)) > 0)  # two seconds: no more comes that would tell the clock
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
    assert [len(points) for points in reference] == [len(scan) for scan in scans]
    for scan, points in zip(scans, reference, strict=True):
        np.testing.assert_array_equal(scan.points_lidar, np.stack([points[axis] for axis in "xyz"], axis=1))
        np.testing.assert_array_equal(scan.ring, points["ring"])
        np.testing.assert_allclose(scan.t_offset_ns * 1e-9, points["time"] - points["time"].min(), atol=2e-6)
    assert listener.source.counts.native_bytes == PACKET_BYTES * sum(
        1 for p in packets if p.port == DATA_PORT
    ) - PACKET_BYTES * found["start"]


def test_a_locked_velodyne_stamps_in_utc_of_its_sentences(shared_data: Path):
    listener = velodyne_run("vlp16", capture("vlp16", shared_data))
    first = listener.of(Scan)[0]
    print(first.stamp_ns, listener.source.clocks.clock("lidar").chosen)


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

OS32, OS128 = "OS-1-32-G_v2.1.1_1024x10", "OS-1-128_v2.3.0_1024x10_lb_n3"


@pytest.fixture
def core() -> Any:
    return pytest.importorskip("ouster.sdk.core", reason="ouster-sdk is not installed")


def ouster_run(name: str, shared_data: Path, tmp_path: Path, **sections: str) -> tuple[wire.Listener, list[Datagram]]:
    folder = shared_data / "fixtures/ouster"
    packets = list(datagrams(folder / f"{name}.pcap"))
    robot = wire.ouster_robot(folder / f"{name}.json", tmp_path, **sections)
    with wire.listening(robot, wire.config()) as listener:
        ports = wire.ports_of(listener.source)
        there = sorted({packet.port for packet in packets})
        send(packets, "127.0.0.1", dict(zip(there, ports, strict=False)), None)
        listener.until(lambda: len(listener.of(Scan)) > 0)
        listener.until_quiet(0.3)
    return listener, packets
