"""A recorded drive sent to a live agent over the wire, by the clock: `python -m benchmarks.live --help`.

The recording's Velodyne packets go out over UDP, its IMU as MIP over a pseudo-terminal, its fixes as NMEA over TCP.
With `gps` all three are locked to one time, which is the recording's; with `host` nobody is, and stamps are by arrival.
"""

from __future__ import annotations

import json
import os
import pty
import re
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import time
import tty
from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import typer
import yaml

if __package__ in (None, ""):  # run as a file
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.command import run
from benchmarks.peers import ROOT
from edge_agent.sources.bag import Bag
from splitslam.evaluate import evaluate
from splitslam.tum import read_tum
from tests.e2e.commands import BIN
from tests.live.made import gga, gst, mip_sample, position_packet, rmc

app = typer.Typer(add_completion=False)
YARD1 = ROOT.parent / "shared" / "data" / "yard1" / "yard1.bag"
HOUR_NS, WEEK_S = 3_600_000_000_000, 604_800
GPS_EPOCH_S, LEAP_S = 315_964_800, 18
PPS_LOCKED, GPS_LOCKED = 2, 0b101


@dataclass(frozen=True, slots=True)
class Outgoing:
    """What is due at `stamp_ns` of the recording, and where it goes: lidar, position, imu or gnss."""

    stamp_ns: int
    to: str
    data: bytes


def outgoing(recording: Path, locked: bool, seconds: float) -> list[Outgoing]:
    """Everything that the sensors would send, in order."""
    with Bag(recording) as bag:
        made = [item for topic, _, message in bag.messages(set(bag.topics())) for item in _sent(message, locked)]
    made.sort(key=lambda item: item.stamp_ns)
    first_ns = made[0].stamp_ns
    return [item for item in made if item.stamp_ns - first_ns < seconds * 1e9]


def _sent(message: Any, locked: bool) -> Iterator[Outgoing]:
    if hasattr(message, "packets"):
        for packet in message.packets:
            stamp_ns = packet.stamp.sec * 10**9 + packet.stamp.nanosec
            data = bytearray(packet.data.tobytes())
            data[1200:1204] = struct.pack("<I", stamp_ns % HOUR_NS // 1000)
            yield Outgoing(stamp_ns + 1_327_000, "lidar", bytes(data))  # sent when it is full
        if locked:
            yield Outgoing(stamp_ns, "position", _position(stamp_ns))
        return
    stamp_ns = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
    if hasattr(message, "linear_acceleration"):
        a, w = message.linear_acceleration, message.angular_velocity
        accel_g = (a.x / 9.80665, a.y / 9.80665, a.z / 9.80665)
        gps_s = stamp_ns * 1e-9 - GPS_EPOCH_S + LEAP_S
        gps = (gps_s % WEEK_S, int(gps_s // WEEK_S), GPS_LOCKED) if locked else None
        yield Outgoing(stamp_ns, "imu", mip_sample(accel_g, (w.x, w.y, w.z), stamp_ns - 10**18, gps))
    elif hasattr(message, "latitude"):
        yield Outgoing(stamp_ns, "gnss", _nmea(message, stamp_ns))


def _position(stamp_ns: int) -> bytes:
    utc = datetime.fromtimestamp(stamp_ns // 10**9, tz=UTC)
    sentence = rmc(utc.strftime("%H%M%S"), utc.strftime("%d%m%y"))
    return position_packet(stamp_ns % HOUR_NS // 1000, sentence, PPS_LOCKED)


def _nmea(fix: Any, stamp_ns: int) -> bytes:
    utc = datetime.fromtimestamp(stamp_ns // 10**9, tz=UTC)
    clock = f"{utc:%H%M%S}.{stamp_ns % 10**9 // 10**6:03d}"
    sigma_m = fix.position_covariance[0] ** 0.5
    place = gga(clock, altitude=f"{fix.altitude:.4f}", geoid="0.0").split(",")
    place[2:6] = [*_degrees(fix.latitude, "NS", 2), *_degrees(fix.longitude, "EW", 3)]
    body = ",".join(place)[1:].partition("*")[0]
    checksum = 0
    for letter in body.encode():
        checksum ^= letter
    sentences = (rmc(clock, f"{utc:%d%m%y}"), f"${body}*{checksum:02X}\r\n", gst(clock, sigma_m, sigma_m, 2 * sigma_m))
    return "".join(sentences).encode()


def _degrees(value: float, letters: str, digits: int) -> tuple[str, str]:
    whole, part = divmod(abs(value), 1.0)
    return f"{int(whole):0{digits}d}{part * 60:010.7f}", letters[value < 0]


@app.command()
def main(
    recording: Annotated[Path, typer.Argument(metavar="BAG", help="Robot file and truth lie beside it.")] = YARD1,
    clock: Annotated[str, typer.Option(help="gps or host: what the sensors are locked to.")] = "gps",
    seconds: Annotated[float, typer.Option(min=5.0, help="Only so many.")] = 1e9,
) -> None:
    """Every packet must be used, every scan mapped; prints a JSON line."""
    with tempfile.TemporaryDirectory() as folder:
        print(json.dumps(drive(recording, clock == "gps", seconds, Path(folder))))


def drive(recording: Path, locked: bool, seconds: float, folder: Path) -> dict[str, Any]:
    """One run; what became of it."""
    items = outgoing(recording, locked, seconds)
    robot = yaml.safe_load(recording.with_suffix(".yaml").read_text())
    for section in ("lidar", "imu", "gnss"):
        robot[section].pop("topic", None)
    (folder / "robot.yaml").write_text(yaml.safe_dump(robot))
    controller, terminal = pty.openpty()
    tty.setraw(terminal)
    receiver = socket.create_server(("127.0.0.1", 0))
    command = [str(BIN / "map-service"), "serve", "--listen", "127.0.0.1:0", "--workers", "1", "--metrics-port", "0"]
    command += ["--store", f"sqlite:///{folder}/s.sqlite"]
    rack = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    assert rack.stdout is not None
    config = {
        "robot": str(folder / "robot.yaml"),
        "server": json.loads(rack.stdout.readline())["grpc"],
        "source": {
            "live": {
                "lidar": {"udp": {"host": "127.0.0.1", "port": 0, "position_port": 0}},
                "imu": {"serial": {"device": os.ttyname(terminal)}},
                "gnss": {"tcp": {"host": "127.0.0.1", "port": receiver.getsockname()[1]}},
            }
        },
        "output": {"dir": str(folder / "out")},
        "metrics": {"port": None},
    }
    (folder / "edge.yaml").write_text(yaml.safe_dump(config))
    log = folder / "agent.log"
    with log.open("w") as stderr:
        agent = subprocess.Popen([BIN / "edge-agent", "run", "--config", folder / "edge.yaml"], stderr=stderr)
    try:
        connection, _ = receiver.accept()  # the agent is there
        ports = {key: int(port) for port, key in re.findall(r"udp 127.0.0.1:(\d+) \((\w+)\)", log.read_text())}
        late_s, ahead_ns = _send(items, ports, controller, connection)
        time.sleep(2.0)
        agent.send_signal(signal.SIGTERM)
        agent.wait(60.0)
        print(log.read_text(), file=sys.stderr)
    finally:
        for process in (agent, rack):
            if process.poll() is None:
                process.kill()
            process.wait()
    report = json.loads((folder / "out" / "edge.json").read_text())
    found = read_tum(folder / "out" / "online.tum")
    estimate = found if locked else replace(found, stamps_ns=found.stamps_ns - ahead_ns)
    score = evaluate(estimate, read_tum(recording.with_suffix(".tum")))
    metrics = (folder / "out" / "metrics.prom").read_text()
    return {
        "clock": "gps" if locked else "host",
        "scans": report["scans"],
        "packets": _packets(metrics),
        "dropped": report["dropped_by_reason"],
        "online_ate_mm": round(1e3 * score.ate_m, 2),
        "scored": score.n,
        "cpu_ms_per_scan": report.get("cpu_ms_per_scan"),
        "sender_late_ms": round(1e3 * late_s, 2),
    }


def _send(items: list[Outgoing], ports: dict[str, int], imu: int, gnss: socket.socket) -> tuple[float, int]:
    """At the recording's pace. How late this was at worst, s, and by how much the wall clock is ahead of stamps, ns."""
    began_s, first_ns, late_s = time.monotonic(), items[0].stamp_ns, 0.0
    ahead_ns = time.time_ns() - first_ns
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        for item in items:
            due_s = began_s + (item.stamp_ns - first_ns) * 1e-9
            wait_s = due_s - time.monotonic()
            if wait_s > 0:
                time.sleep(wait_s)
            late_s = max(late_s, -wait_s)
            if item.to == "imu":
                os.write(imu, item.data)
            elif item.to == "gnss":
                gnss.sendall(item.data)
            else:
                out.sendto(item.data, ("127.0.0.1", ports["port" if item.to == "lidar" else "position_port"]))
    return late_s, ahead_ns


def _packets(page: str) -> dict[str, dict[str, float]]:
    """By sensor and what became of them, without zeros."""
    found: dict[str, dict[str, float]] = {}
    for result, sensor, count in re.findall(
        r'^splitslam_edge_sensor_packets_total\{result="(\w+)",sensor="(\w+)"\} (\S+)$', page, re.MULTILINE
    ):
        if float(count):
            found.setdefault(sensor, {})[result] = float(count)
    return found


if __name__ == "__main__":
    run(app)
