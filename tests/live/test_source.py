"""Live sensors as the agent reads them: silence, return, the end, and what is kept for whoever asks later."""

from __future__ import annotations

import itertools
import logging
import os
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from edge_agent.config import RawRingConfig
from edge_agent.metrics import EdgeMetrics
from edge_agent.raw_ring import RawRing
from edge_agent.reader import EventQueue, Reader
from edge_agent.sources import open_recording
from edge_agent.sources.live import udp_port
from edge_agent.sources.live.opening import open_live
from edge_agent.sources.live.raw_messages import RawMessages
from splitslam.diagnose.raw import write_raw
from splitslam.errors import InputError
from splitslam.robot import Robot
from splitslam.scan import GnssFix, ImuSamples, Scan
from tests.live import wire
from tests.live.made import STEP_US, data_packet, gga, mip_sample, rmc
from tests.logs.said import said

IMU = {"T_lidar_imu": np.eye(4).tolist(), "imu": {"rate_hz": 100}, "gnss": {}}


def send_packets(port: int, first: int, count: int, pause_s: float = 0.0) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        for number in range(first, first + count):
            out.sendto(data_packet(number, 1e6), ("127.0.0.1", port))
            time.sleep(pause_s)


@contextmanager
def sending(port: int, first: int) -> Iterator[None]:
    """A sensor that is there for as long as the block runs."""
    over = threading.Event()

    def send() -> None:
        for number in itertools.count(first):
            if over.is_set():
                return
            send_packets(port, number, 1, STEP_US * 1e-6)

    sender = threading.Thread(target=send)
    sender.start()
    try:
        yield
    finally:
        over.set()
        sender.join()


def robot(**sections: object) -> Robot:
    return wire.velodyne_robot("vlp16", **sections)


def test_close_from_another_thread_ends_events_at_once_and_twice_is_no_error():
    with wire.listening(robot(), wire.config()) as listener:
        listener.until(lambda: listener.rests > 2)
        assert listener.close() < 20.0  # nothing else would end it
        listener.source.close()


def test_a_source_that_nobody_iterates_gives_its_ports_back():
    source = open_live(wire.config(), robot())
    port = wire.ports_of(source)[1]
    source.close()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as again:
        again.bind(("127.0.0.1", port))


def test_while_nothing_comes_control_comes_back_several_times_a_second():
    with wire.listening(robot(), wire.config()) as listener:
        listener.until(lambda: listener.rests > 0)
        before = listener.rests
        listener.until(lambda: listener.rests - before >= 4, timeout_s=30.0)


def test_a_lidar_that_falls_silent_and_comes_back_is_said_once_each_and_the_run_goes_on(
    caplog: pytest.LogCaptureFixture,
):
    with (
        caplog.at_level(logging.WARNING),
        wire.listening(robot(), wire.config(silent_s=2.0)) as listener,
    ):
        port = wire.ports_of(listener.source)[1]
        with sending(port, 0):
            listener.until(lambda: len(listener.of(Scan)) >= 10)
        listener.until(lambda: "lidar silent" in listener.source.status())
        before = len(listener.of(Scan))
        with sending(port, 30_000):
            listener.until(lambda: len(listener.of(Scan)) > before)
            assert listener.source.status() == ""
            assert listener.source.presence.losses == {"lidar": 1}
            events = [event for event, _ in said(caplog)]
    assert events.count("sensor silent") == events.count("sensor is back") == 1


def test_a_sensor_that_has_never_come_is_said_and_not_waited_for(tmp_path: Path, caplog: pytest.LogCaptureFixture):
    settings = wire.config(imu={"serial": {"device": str(tmp_path / "ttyACM0")}}, silent_s=0.3)
    with caplog.at_level(logging.WARNING), wire.listening(robot(**IMU), settings) as listener:
        port = wire.ports_of(listener.source)[1]
        send_packets(port, 0, 3000, STEP_US * 1e-6)
        listener.until(lambda: len(listener.of(Scan)) >= 3)
        assert "imu silent" in listener.source.status()
    assert ("sensor not heard yet", "imu") in [(event, found.get("sensor")) for event, found in said(caplog)]


def test_lidar_imu_and_gnss_come_together_in_one_time(tmp_path: Path):
    with wire.terminal(tmp_path, "ttyACM0") as (imu, imu_end), wire.terminal(tmp_path, "ttyACM1") as (gnss, gnss_end):
        settings = wire.config(imu={"serial": {"device": str(imu)}}, gnss={"serial": {"device": str(gnss)}})
        with wire.listening(robot(**IMU), settings) as listener:
            port = wire.ports_of(listener.source)[1]
            began_s, k = time.monotonic(), 0
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
                while k < 2500:
                    out.sendto(data_packet(k, 1e6), ("127.0.0.1", port))
                    if k % 15 == 0:
                        os.write(imu_end, mip_sample(reference_ns=77 * 10**9 + round(k * STEP_US * 1000)))
                    if k % 150 == 0:
                        utc = time.strftime("%H%M%S", time.gmtime()) + f".{time.time_ns() // 10**7 % 100:02d}"
                        os.write(
                            gnss_end, gga(utc).encode() + rmc(utc, time.strftime("%d%m%y", time.gmtime())).encode()
                        )
                    k += 1
                    time.sleep(max(began_s + k * STEP_US * 1e-6 - time.monotonic(), 0.0))
            listener.until_quiet()
            scans, samples = listener.of(Scan), ImuSamples.joined(listener.of(ImuSamples))
            fixes = listener.of(GnssFix)
    assert len(scans) >= 30
    assert len(samples) == 167
    assert len(fixes) >= 14
    now_ns = time.time_ns()
    for newest_ns in (scans[-1].stamp_ns, int(samples.stamps_ns[-1]), fixes[-1].stamp_ns):
        assert 0 < now_ns - newest_ns < 30_000_000_000
    # the IMU's stamp of a packet that left with it: both came by loopback, so within the system's jitter
    assert abs(int(samples.stamps_ns[0]) - (scans[0].stamp_ns - round(76 * STEP_US * 1000))) < 20_000_000
    assert wire.counts(listener.source, "imu") == {"used": 167}


def test_the_readers_thread_passes_on_what_has_come_and_is_never_stuck():
    source = open_live(wire.config(), robot())
    queue = EventQueue(20, may_drop=True, metrics=EdgeMetrics())
    reader = Reader(source.events(), queue, realtime=True, live_offset_ns=source.live_offset_ns)
    reader.start()
    busy_s, began_s = [], time.monotonic()
    send_packets(wire.ports_of(source)[1], 0, 1200, STEP_US * 1e-6)
    scans = []
    for batch in queue.batches():
        busy_s.append(reader.pulse.busy_s)
        scans += [(arrival_ns, data) for arrival_ns, data in batch if isinstance(data, Scan)]
        if len(scans) >= 8:
            break
    took_s = time.monotonic() - began_s
    late_s = time.monotonic() - reader.due_s(scans[-1][0])
    reader.close()
    source.close()
    assert 0.0 <= late_s < 10.0
    assert max(busy_s) < 0.5 * took_s


def test_raw_scans_of_a_live_run_give_the_same_scans_again(tmp_path: Path):
    ring = RawRing(tmp_path / "raw", RawRingConfig(dir=tmp_path / "raw"))
    with wire.terminal(tmp_path) as (device, end):
        source = open_live(wire.config(imu={"serial": {"device": str(device)}}), robot(**IMU))
        source.tap = ring.add
        listener = wire.Listener(source)
        try:
            for k in range(100):
                os.write(end, mip_sample((0.1, 0.2, 1.0), reference_ns=k * 15_000_000))
                send_packets(wire.ports_of(source)[1], 12 * k, 12, STEP_US * 1e-6)
            listener.until_quiet()
        finally:
            listener.close()
    ring.close()
    (tmp_path / "again").mkdir()
    part = write_raw(tmp_path / "raw", 60.0, tmp_path / "again")
    assert part.path is not None
    with open_recording(part.path, source.robot) as recording:
        again = [event for _, event in recording.events()]
    scans, scans_again = listener.of(Scan), [event for event in again if isinstance(event, Scan)]
    assert [scan.stamp_ns for scan in scans_again] == [scan.stamp_ns for scan in scans]
    for scan, same in zip(scans, scans_again, strict=True):
        np.testing.assert_array_equal(scan.points_lidar, same.points_lidar)
        np.testing.assert_array_equal(scan.t_offset_ns, same.t_offset_ns)
    samples = ImuSamples.joined([event for event in again if isinstance(event, ImuSamples)])
    np.testing.assert_array_equal(samples.stamps_ns, ImuSamples.joined(listener.of(ImuSamples)).stamps_ns)
    np.testing.assert_allclose(samples.accel_mps2, ImuSamples.joined(listener.of(ImuSamples)).accel_mps2)


@pytest.mark.parametrize("stamp_ns", [-1, (315_964_800 + 5000 * 604_800) * 10**9, 2**62])
def test_a_stamp_that_no_ros_message_holds_is_not_kept_and_ends_no_run(stamp_ns: int, caplog: pytest.LogCaptureFixture):
    kept: list[bytes] = []
    raw = RawMessages(lambda stream, arrival_ns, data: kept.append(bytes(data)))
    samples = ImuSamples(np.array([stamp_ns]), np.zeros((1, 3)), np.zeros((1, 3)))
    scan = Scan(
        stamp_ns, stamp_ns, np.ones((1, 3), np.float32), np.zeros(1, "i4"), np.zeros(1, "u1"), np.zeros(1, "u1")
    )
    for event in (samples, scan, GnssFix(stamp_ns, 48.0, 11.0, 0.0, None)):
        raw.put(10**18, event, (), 0)
    assert not kept
    assert [event for event, _ in said(caplog)] == ["raw messages not kept"]
    raw.put(10**18, ImuSamples(np.array([10**18]), np.zeros((1, 3)), np.zeros((1, 3))), (), 0)
    assert len(kept) == 1


@pytest.mark.parametrize(
    ("sections", "settings", "line"),
    [
        ({"lidar": {"model": "generic"}}, {}, "lidar.model: generic is not read live; expected one of vlp16"),
        (
            {"lidar": {"model": "hdl64"}},
            {},
            "lidar.model: hdl64 is not read live; expected one of vlp16, hdl32, ouster",
        ),
        ({"lidar": {"model": "ouster"}}, {}, "lidar.metadata: must be given"),
        ({}, {"imu": {"serial": {"device": "/dev/null"}}}, "source.live.imu: the robot file says that there is none"),
        ({}, {"gnss": {"tcp": {"host": "::1", "port": 9}}}, "source.live.gnss: the robot file says"),
        ({"imu": {}}, {"imu": {"serial": {"device": "/dev/nowhere"}}}, "T_lidar_imu: must be given"),
    ],
)
def test_what_does_not_fit_is_one_clear_line_and_no_port_stays_open(
    sections: dict[str, object], settings: dict[str, object], line: str, free_port: Callable[[], int]
):
    port = free_port()
    udp = {**wire.UDP, "port": port}
    with pytest.raises(InputError, match=line):
        open_live(wire.config(lidar={"udp": udp}, **settings), robot(**sections))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as again:
        again.bind(("127.0.0.1", port))


@pytest.fixture
def free_port() -> Callable[[], int]:
    def find() -> int:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as found:
            found.bind(("127.0.0.1", 0))
            return found.getsockname()[1]

    return find


def test_a_reader_that_was_held_up_takes_what_waited_for_it_as_one_stream(monkeypatch: pytest.MonkeyPatch):
    source = open_live(wire.config(), robot())
    port = wire.ports_of(source)[1]
    monkeypatch.setattr(udp_port, "_AT_ONCE", 40)
    send_packets(port, 0, 152)
    time.sleep(0.4)  # longer than what counts as quiet
    listener = wire.Listener(source)
    try:
        listener.until_quiet()
    finally:
        listener.close()
    assert wire.counts(source, "lidar") == {"start": 76, "used": 76}
