"""Nothing is told to anybody but those who are configured."""

from __future__ import annotations

import sys
from pathlib import Path

from splitslam.security.loopback import is_loopback
from tests.e2e.commands import BIN
from tests.security.strace import addresses


def test_a_run_talks_to_its_own_service_and_to_nobody_else(shared_data: Path, tmp_path: Path) -> None:
    recording = shared_data / "yard1" / "yard1.bag"
    run = ["run", str(recording), "--robot", str(recording.with_suffix(".yaml")), "--max-scans", "10"]
    talked = addresses([str(BIN / "splitslam"), *run, "--out", str(tmp_path / "out")], tmp_path)
    assert talked, "not even the agent's own stream was seen"
    assert len({port for _, port in talked}) == 1, talked
    assert all(is_loopback(address.removeprefix("::ffff:")) for address, _ in talked), talked


def test_a_word_to_somebody_else_would_be_seen(tmp_path: Path) -> None:
    """Also one that nobody hears: 192.0.2.0/24 is in no network."""
    program = "import socket; s = socket.socket(type=socket.SOCK_DGRAM); s.sendto(b'x', ('127.0.0.2', 9))\n"
    program += "t = socket.socket(); t.setblocking(False); t.connect_ex(('192.0.2.1', 443))"
    seen = addresses([sys.executable, "-c", program], tmp_path)
    assert seen == {("127.0.0.2", 9), ("192.0.2.1", 443)}
