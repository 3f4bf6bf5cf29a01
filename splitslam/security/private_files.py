"""Files that only their owner may read, written whole or not at all."""

from __future__ import annotations

import contextlib
import os
import secrets
from pathlib import Path

from splitslam.durable import sync


def write_private(path: Path, data: bytes) -> None:
    """Mode 0600 from its first byte on; whoever reads meanwhile sees the old content or the new. Raises OSError."""
    fresh = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    handle = os.open(fresh, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(fresh, path)
    except BaseException:
        with contextlib.suppress(FileNotFoundError):
            fresh.unlink()
        raise
    sync(path.parent)


def make_private_folder(path: Path) -> None:
    """With parents, mode 0700 where it is made; one that is there is left as it is."""
    if not path.is_dir():
        path.mkdir(parents=True, mode=0o700)
