"""Whether an address stays on this machine."""

from __future__ import annotations

import ipaddress


def is_loopback(address: str) -> bool:
    """HOST:PORT or HOST. A name other than `localhost` is another machine, wherever it may lead today."""
    host = address.rpartition(":")[0] if ":" in address else address
    host = host.removeprefix("[").removesuffix("]")
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
