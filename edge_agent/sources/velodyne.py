"""velodyne_msgs/VelodyneScan: the sensor's own packets, decoded with `velodyne-decoder`.

Times. A packet's stamp is the time of its first firing. Inside a packet the time of a return follows from its
firing and laser alone (VLP-16: 55.296 us a firing sequence, 2.304 us a laser; VLP-16 user manual, section 9.4), so
it comes from a table in integer nanoseconds that is learnt once from the decoder itself. Between packets the sensor's
own microsecond clock counts, not the host's arrival stamps, unless the host stamps follow it within 2 us (then they
come from the same clock and are finer).

Dual return: one return per firing is kept, the strongest.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import velodyne_decoder as vd
from numpy.typing import NDArray

from edge_agent.sources.raw import RawScan
from splitslam.errors import DataError, InputError

PACKET_BYTES = 1206
_STRONGEST = 1
_DUAL = 0x39
_HOUR_US = 3_600_000_000
_MAX_SCAN_NS = 2_000_000_000
_COARSE_NS = 5_000  # the decoder's times: microseconds of the sensor, as float32
SENSOR_OF_CODE = {0x21: "hdl32", 0x22: "vlp16"}
_MODELS = {"vlp16": vd.Model.VLP16, "hdl32": vd.Model.HDL32E}
_PER_FIRING = {"vlp16": 16, "hdl32": 32}


class VelodyneDecoder:
    """VelodyneScan messages -> RawScan for one sensor model (`vlp16`, `hdl32`, or any the decoder detects)."""

    def __init__(self, model: str) -> None:
        self._model = model
        self._decoder = vd.ScanDecoder(
            vd.Config(model=_MODELS.get(model), min_range=0.0, max_range=1000.0, timestamp_first_packet=True)
        )
        self._tables: dict[bool, NDArray[np.int64]] = {}

    def check(self, message: Any) -> None:
        """InputError text when the packets say they come from another sensor than the robot file."""
        if len(message.packets) == 0 or len(message.packets[0].data) != PACKET_BYTES:
            return
        sensor = SENSOR_OF_CODE.get(int(message.packets[0].data[-1]))
        if sensor is not None and sensor != self._model:
            raise InputError(f"lidar.model: packets come from a {sensor}, expected lidar.model: {sensor}")

    def __call__(self, message: Any) -> RawScan:
        """One message -> all its returns. DataError `empty` or `decode`."""
        packets = message.packets
        if len(packets) == 0:
            raise DataError("empty", "no packets")
        data = [packet.data.tobytes() for packet in packets]
        if any(len(packet) != PACKET_BYTES for packet in data):
            raise DataError("decode", f"a packet is not {PACKET_BYTES} bytes long")
        host_ns = np.array([p.stamp.sec * 1_000_000_000 + p.stamp.nanosec for p in packets], dtype=np.int64)
        if host_ns[0] == 0:
            host_ns = host_ns + message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
        return self.decode(data, host_ns)

    def decode(self, data: list[bytes], host_ns: NDArray[np.int64]) -> RawScan:
        """Packets of 1206 bytes, and the stamp of each, (M,) int64 -> all their returns. DataError `decode`."""
        packet_ns = _packet_offsets_ns(data, host_ns)
        dual = data[0][-2] == _DUAL
        if self._model in _PER_FIRING:
            table = self._table(dual)
            points, t_ns = self._timed(data, packet_ns, table)
            end_ns = int(packet_ns[-1] + table.max())
        else:
            points = self._decode(data)
            t_ns = np.rint(points["time"].astype(np.float64) * 1e9).astype(np.int64)
            end_ns = int(max(t_ns.max(initial=0), packet_ns[-1]))
        if dual:
            strongest = (points["return_type"] & _STRONGEST) != 0
            points, t_ns = points[strongest], t_ns[strongest]
        xyz = np.stack([points["x"], points["y"], points["z"]], axis=1)
        return RawScan(
            stamp_ns=int(host_ns[0]),
            end_ns=int(host_ns[0]) + end_ns,
            points_lidar=xyz,
            t_offset_ns=t_ns,
            ring=points["ring"],
            intensity=np.clip(points["intensity"], 0, 255).astype(np.uint8),
            native_bytes=PACKET_BYTES * len(data),
        )

    def _timed(
        self, data: list[bytes], packet_ns: NDArray[np.int64], table: NDArray[np.int64]
    ) -> tuple[Any, NDArray[np.int64]]:
        """All returns, and their exact times after the first packet's first firing, (N,) int64 ns.

        The decoder numbers firings through the message but leaves out packets without any return; its own times,
        coarser but always of the right packet, show when it did. Then the packets are decoded one by one.
        """
        points = self._decode(data)
        packet, firing = np.divmod(points["column"].astype(np.int64), len(table))
        if packet.max(initial=0) < len(data):
            t_ns = packet_ns[packet] + table[firing, points["ring"]]
            if np.abs(t_ns - points["time"].astype(np.float64) * 1e9).max(initial=0.0) < _COARSE_NS:
                return points, t_ns
        parts = [self._decode([packet]) for packet in data]
        times = [
            start_ns + table[part["column"] % len(table), part["ring"]]
            for part, start_ns in zip(parts, packet_ns, strict=True)
        ]
        return np.concatenate(parts), np.concatenate(times)

    def _decode(self, data: list[bytes]) -> Any:
        vector = vd.PacketVector()
        for packet in data:
            vector.append(vd.VelodynePacket(0.0, packet))  # type: ignore[arg-type]  (bytes are a sequence of int)
        try:
            return self._decoder.decode(vector, True)[1]
        except (RuntimeError, ValueError) as error:
            raise DataError("decode", str(error)) from error

    def _table(self, dual: bool) -> NDArray[np.int64]:
        """(firings in a packet, rings) int64: ns after the packet's first firing."""
        if dual not in self._tables:
            self._tables[dual] = _learn_table(self._model, dual)
        return self._tables[dual]


def _packet_offsets_ns(data: list[bytes], host_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """Time of each packet after the first one, ns."""
    tail = np.frombuffer(b"".join(packet[1200:1204] for packet in data), dtype="<u4").astype(np.int64)
    sensor_ns = (tail - tail[0]) % _HOUR_US * 1000  # the sensor counts microseconds since the full hour
    offsets_ns = host_ns - host_ns[0]
    sensor_runs = bool((np.diff(sensor_ns) > 0).all()) and sensor_ns[-1] < _MAX_SCAN_NS
    if sensor_runs and np.abs(offsets_ns - sensor_ns).max() > 2000:
        return sensor_ns
    if (np.diff(offsets_ns) < 0).any():
        raise DataError("point_time", "packets of one scan go back in time")
    return offsets_ns


def _learn_table(model: str, dual: bool) -> NDArray[np.int64]:
    """Decodes one packet in which every laser returns, and reads the decoder's own times off it."""
    code = {name: number for number, name in SENSOR_OF_CODE.items()}[model]
    block_pair = 2 if dual else 1
    packet = bytearray()
    for block in range(12):
        packet += b"\xff\xee" + (40 * (block // block_pair)).to_bytes(2, "little")
        packet += ((2000 + 500 * (block % block_pair)).to_bytes(2, "little") + b"\x10") * 32
    packet += (0).to_bytes(4, "little") + bytes([_DUAL if dual else 0x37, code])
    vector = vd.PacketVector()
    vector.append(vd.VelodynePacket(0.0, bytes(packet)))  # type: ignore[arg-type]
    config = vd.Config(model=_MODELS[model], min_range=0.0, max_range=1000.0, timestamp_first_packet=True)
    points: Any = vd.ScanDecoder(config).decode(vector, True)[1]
    table = np.zeros((int(points["column"].max()) + 1, _PER_FIRING[model]), dtype=np.int64)
    # All of a sensor's timings are whole nanoseconds; the decoder gives them as float32 seconds.
    table[points["column"], points["ring"]] = np.rint(points["time"].astype(np.float64) * 1e9)
    return table
