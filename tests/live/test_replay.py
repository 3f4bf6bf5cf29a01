"""`splitslam replay`: captures are read whole, sent at their pace, and harmed only as asked."""

from __future__ import annotations

import socket
import struct
import time
from collections import Counter
from pathlib import Path

import dpkt
import pytest

from splitslam.errors import InputError
from splitslam.pcap import Datagram, datagrams
from splitslam.replay import Faults, send, with_faults
from tests.typed import typed

PACKETS = [Datagram(k * 10_000_000, 2368, struct.pack("<I", k)) for k in range(200)]


def ip_packet(payload: bytes, offset: int = 0, more: bool = False, number: int = 7) -> bytes:
    flags = (0x2000 if more else 0) | offset // 8
    head = struct.pack(
        ">BBHHHBBH4s4s", 0x45, 0, 20 + len(payload), number, flags, 64, 17, 0, b"\x0a\0\0\1", b"\x0a\0\0\2"
    )
    return bytes(12) + b"\x08\x00" + head + payload


def udp(data: bytes, port: int = 7502) -> bytes:
    return struct.pack(">HHHH", 1234, port, 8 + len(data), 0) + data


def written(path: Path, frames: list[bytes]) -> Path:
    with path.open("wb") as file:
        writer = dpkt.pcap.Writer(file)
        for k, frame in enumerate(frames):
            writer.writepkt(frame, ts=1000 + k)
    return path


def test_a_datagram_that_was_cut_up_is_put_together_in_any_order_and_others_between_do_not_matter(tmp_path: Path):
    data = bytes(range(256)) * 10
    whole = udp(data)
    frames = [
        ip_packet(whole[1600:], offset=1600),
        ip_packet(udp(b"between"), number=8),
        ip_packet(whole[:800], more=True),
        ip_packet(bytes(800), more=True, number=9),  # the rest of this one never comes
        ip_packet(whole[800:1600], offset=800, more=True),
        bytes(12) + b"\x08\x06" + bytes(28),  # ARP
    ]
    found = list(datagrams(written(tmp_path / "cut.pcap", frames)))
    assert [(d.port, d.data) for d in found] == [(7502, b"between"), (7502, data)]
    assert found[1].stamp_ns == 1_004_000_000_000


@pytest.mark.parametrize("content", [b"", b"not a capture at all", None])
def test_what_is_no_capture_is_one_clear_line(content: bytes | None, tmp_path: Path):
    path = tmp_path / "x.pcap"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match="expected a capture"):
        list(datagrams(path))


def test_faults_are_those_that_were_asked_for_and_the_same_for_the_same_seed():
    done: Counter[str] = Counter()
    once = list(with_faults(PACKETS, Faults(lost=0.1, twice=0.1, late=0.1, seed=3), done))
    assert once == list(with_faults(PACKETS, Faults(lost=0.1, twice=0.1, late=0.1, seed=3), Counter()))
    assert once != list(with_faults(PACKETS, Faults(lost=0.1, twice=0.1, late=0.1, seed=4), Counter()))
    assert len(once) == 200 - done["lost"] + done["twice"]
    assert len({p.data for p in once}) == 200 - done["lost"]
    assert all(5 < count < 40 for count in done.values())
    assert list(with_faults(PACKETS, Faults(), Counter())) == PACKETS


def test_packets_go_to_their_ports_at_their_pace():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sensor:
        sensor.bind(("127.0.0.1", 0))
        sensor.settimeout(5.0)
        began_s = time.monotonic()
        assert send(PACKETS[:40], "127.0.0.1", {2368: sensor.getsockname()[1]}, speed=2.0) == {2368: 40}
        assert time.monotonic() - began_s >= 0.195
        assert [sensor.recv(100) for _ in range(40)] == [packet.data for packet in PACKETS[:40]]


def test_the_command_says_what_it_has_sent_and_what_it_does_not_understand(shared_data: Path):
    capture = str(shared_data / "fixtures/velodyne/vlp16_gps.pcap")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sensor:
        sensor.bind(("127.0.0.1", 0))
        port = sensor.getsockname()[1]
        done = typed("splitslam", "replay", capture, "--port", f"2368={port}", "--port", f"8308={port}", "--speed", "0")
        assert done.exit_code == 0, done.err
        assert done.out.splitlines() == [f"293 packets to 127.0.0.1:{port}", f"57 packets to 127.0.0.1:{port}"]
    for words, said in (
        (("--to", "robot.local"), "--to: expected an IP address"),
        (("--port", "2368"), "--port: expected FROM=TO"),
    ):
        exit_code, _, err = typed("splitslam", "replay", capture, *words)
        (line,) = err.splitlines()
        assert exit_code == 2
        assert line.startswith(said)
