"""Which addresses a command and all it starts talk to, as the kernel saw it."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

from tests.debian import binary

_CALLS = "connect,sendto,sendmsg,sendmmsg"
# connect(7, {sa_family=AF_INET, sin_port=htons(443), sin_addr=inet_addr("192.0.2.1")}, 16); IPv6: inet_pton(..., "::1")
_ADDRESS = re.compile(
    r"sa_family=AF_INET6?, sin6?_port=htons\((\d+)\).*?(?:inet_addr\(|inet_pton\(AF_INET6, )\"([^\"]+)\""
)


def addresses(command: list[str], folder: Path, timeout_s: float = 280.0) -> set[tuple[str, int]]:
    """(address, port) of every connection and datagram, connections that failed as well. The command must succeed."""
    log = folder / "strace.log"
    traced = [
        str(binary("strace", "strace")),
        "-f",
        "--seccomp-bpf",
        "-qq",
        "-e",
        f"trace={_CALLS}",
        "-o",
        str(log),
        *command,
    ]
    done = subprocess.run(traced, capture_output=True, text=True, timeout=timeout_s)
    assert done.returncode == 0, done.stderr[-2000:]
    return {(address, int(port)) for port, address in _ADDRESS.findall(log.read_text(errors="replace"))}
