"""A file appears under its name when it is complete and on disk, or not at all."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from splitslam.durable import sync
from splitslam.errors import InputError


def check_target(path: Path, force: bool) -> None:
    """Raises InputError when no file may be written there: only a file, only with `force`, is ever replaced."""
    folder = path.absolute().parent
    if not folder.is_dir():
        raise InputError(f"--out {path}: expected a file in a folder that exists, found no {folder}")
    if path.is_dir():
        raise InputError(f"--out {path}: expected a file, found a folder")
    if not force and path.exists():
        raise InputError(f"--out {path}: is there already (--force replaces it)")


@contextmanager
def complete(path: Path, force: bool) -> Iterator[Path]:
    """A name beside `path` to write to; what is there takes the name `path` when the block ends without an error.

    Whatever ends it otherwise (Ctrl-C, a full disk, a server that goes away), the part is removed and `path` is as it
    was. Raises InputError as check_target does, OSError for a disk that fails.
    """
    check_target(path, force)
    try:
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".part", dir=path.absolute().parent)
    except OSError as error:
        raise InputError(f"--out {path}: expected a folder that can be written ({error.strerror})") from None
    os.close(handle)
    part = Path(name)
    try:
        yield part
        part.chmod(0o666 & ~_umask())  # a temporary file is for its owner alone
        sync(part)
        check_target(path, force)  # somebody else may have been quicker
        part.replace(path)
        with suppress(OSError):  # not every file system can
            sync(path.absolute().parent)
    except OSError as error:
        if error.filename == str(part):  # a name that nobody knows
            error.filename = str(path)
        raise
    finally:
        part.unlink(missing_ok=True)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
