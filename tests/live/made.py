"""Packets of sensors that do not exist."""

from __future__ import annotations

import struct
from collections.abc import Iterator

VLP16 = 0x22
STEP_US = 1327.104  # between two packets of a VLP-16, strongest return
TURN_PACKETS = 75.4  # at 10 Hz
HOUR_US = 3_600_000_000


def data_packet(number: int, start_us: float = 0.0, code: int = VLP16, range_steps: int = 2500) -> bytes:
    """The VLP-16's packet of this number: it turns evenly and sees a wall all around. start_us: its clock at 0."""
    azimuth = 36_000 * number / TURN_PACKETS
    blocks = b"".join(
        b"\xff\xee"
        + struct.pack("<H", int(azimuth + 36_000 / TURN_PACKETS * block / 12) % 36_000)
        + struct.pack("<HB", range_steps, 7) * 32
        for block in range(12)
    )
    return blocks + struct.pack("<IBB", int(start_us + number * STEP_US) % HOUR_US, 0x37, code)


def position_packet(since_hour_us: int, sentence: str, pps: int = 2) -> bytes:
    """A VLP-16's position packet."""
    body = bytearray(512)
    struct.pack_into("<IB", body, 198, since_hour_us, pps)
    body[206 : 206 + len(sentence)] = sentence.encode()
    return bytes(body)


def nmea(body: str) -> str:
    """`GPRMC,...` as a sentence with its checksum."""
    checksum = 0
    for letter in body.encode():
        checksum ^= letter
    return f"${body}*{checksum:02X}\r\n"


def rmc(hhmmss: str, ddmmyy: str, valid: bool = True) -> str:
    return nmea(f"GPRMC,{hhmmss},{'A' if valid else 'V'},4807.038,N,01131.000,E,0.0,0.0,{ddmmyy},,,A")


def gga(hhmmss: str, quality: int = 1, hdop: str = "0.9", altitude: str = "545.4", geoid: str = "46.9") -> str:
    return nmea(f"GPGGA,{hhmmss},4807.038,N,01131.000,E,{quality},08,{hdop},{altitude},M,{geoid},M,,")


def gst(hhmmss: str, latitude_m: float, longitude_m: float, altitude_m: float) -> str:
    return nmea(f"GPGST,{hhmmss},1.0,,,,{latitude_m},{longitude_m},{altitude_m}")


def mip_packet(fields: dict[int, bytes], descriptor_set: int = 0x80) -> bytes:
    """A MIP packet with these fields, checksummed the slow way."""
    payload = b"".join(bytes([len(data) + 2, kind]) + data for kind, data in fields.items())
    packet = b"\x75\x65" + bytes([descriptor_set, len(payload)]) + payload
    first = second = 0
    for byte in packet:
        first = (first + byte) % 256
        second = (second + first) % 256
    return packet + bytes([first, second])


def mip_sample(
    accel_g: tuple[float, float, float] = (0.0, 0.0, 1.0),
    gyro_radps: tuple[float, float, float] = (0.0, 0.0, 0.0),
    reference_ns: int | None = None,
    gps: tuple[float, int, int] | None = None,
) -> bytes:
    """Accelerometer and gyro, with the device's own time and GPS' (time of week s, week, flags), if given."""
    fields = {} if reference_ns is None else {0xD5: struct.pack(">Q", reference_ns)}
    if gps is not None:
        fields[0x12] = struct.pack(">dHH", *gps)
    return mip_packet(fields | {0x04: struct.pack(">3f", *accel_g), 0x05: struct.pack(">3f", *gyro_radps)})


def pieces(stream: bytes, sizes: Iterator[int]) -> Iterator[bytes]:
    """The stream, as reads return it."""
    at = 0
    while at < len(stream):
        size = next(sizes)
        yield stream[at : at + size]
        at += size
