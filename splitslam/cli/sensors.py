"""`splitslam replay`: a live agent without a sensor."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from splitslam.errors import InputError


def replay(
    capture: Annotated[Path, typer.Argument(metavar="FILE", help="UDP packets of sensors: .pcap, .pcapng.")],
    to: Annotated[str, typer.Option(metavar="ADDRESS", help="Of the machine where the agent listens.")] = "127.0.0.1",
    port: Annotated[
        list[str] | None, typer.Option(metavar="FROM=TO", help="What went to port FROM goes to TO; may be repeated.")
    ] = None,
    speed: Annotated[float, typer.Option(metavar="X", min=0.0, help="Times the captured pace; 0: as it goes.")] = 1.0,
    times: Annotated[int, typer.Option(metavar="N", min=1, help="So often, one after the other.")] = 1,
    lost: Annotated[float, typer.Option(metavar="P", min=0.0, max=1.0, help="Share of packets left out.")] = 0.0,
    late: Annotated[float, typer.Option(metavar="P", min=0.0, max=1.0, help="Share that swaps with the next.")] = 0.0,
    twice: Annotated[float, typer.Option(metavar="P", min=0.0, max=1.0, help="Share that is sent twice.")] = 0.0,
    seed: Annotated[int, typer.Option(metavar="N", help="Of these faults.")] = 0,
) -> None:
    """Send the packets of a capture again, as the sensor did, for an agent with `source: {live: ...}`."""
    from collections import Counter
    from ipaddress import ip_address

    from splitslam.pcap import datagrams
    from splitslam.replay import Faults, send, with_faults

    try:
        ip_address(to)
    except ValueError:
        raise InputError(f"--to: expected an IP address, found {to}") from None
    ports = dict(_pair(text) for text in port or ())
    sent: Counter[int] = Counter()
    done: Counter[str] = Counter()
    for number in range(times):
        faults = Faults(lost, twice, late, seed + number)
        sent += send(with_faults(datagrams(capture), faults, done), to, ports, speed or None)
    if not sent:
        raise InputError(f"{capture}: no UDP packets in it")
    for number, count in sorted(sent.items()):
        print(f"{count} packets to {to}:{ports.get(number, number)}")
    if done:
        print(", ".join(f"{count} {what}" for what, count in sorted(done.items())))


def _pair(text: str) -> tuple[int, int]:
    before, _, after = text.partition("=")
    if not (before.isdecimal() and after.isdecimal() and 0 < int(after) < 65536):
        raise InputError(f"--port: expected FROM=TO, such as 2368=12368, found {text}")
    return int(before), int(after)
