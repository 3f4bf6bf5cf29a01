"""The file that is made: a zip of texts without secrets and of raw messages."""

from __future__ import annotations

import json
import os
import zipfile
from pathlib import Path
from types import TracebackType
from typing import Any

from splitslam.errors import InputError
from splitslam.redact import Redactor


class Bundle:
    """Written beside `path` and put in its place when it is whole. Every text goes through the redactor.

    Raises InputError when it cannot be written.
    """

    def __init__(self, path: Path, redactor: Redactor) -> None:
        self.path, self.redactor = path, redactor
        self._part = path.with_name(f".{path.name}.part")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            # Who may read it, decides who made it: logs and positions are in it.
            fd = os.open(self._part, os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, 0o600)
        except OSError as error:
            raise InputError(f"--out {path}: {error.strerror}; expected a file that can be written") from None
        self._zip = zipfile.ZipFile(os.fdopen(fd, "w+b"), "w", zipfile.ZIP_DEFLATED, compresslevel=1)

    def text(self, name: str, text: str) -> None:
        self._zip.writestr(name, self.redactor.text(text))

    def json(self, name: str, value: Any) -> None:
        self.text(name, json.dumps(value, indent=1, default=str) + "\n")

    def raw(self, name: str, path: Path) -> None:
        """A file of sensor messages, as it is: in those there are no secrets."""
        self._zip.write(path, name)

    def __enter__(self) -> Bundle:
        return self

    def __exit__(self, kind: type[BaseException] | None, _: BaseException | None, __: TracebackType | None) -> None:
        file = self._zip.fp
        self._zip.close()
        if file is not None:
            file.close()
        if kind is None:
            self._part.replace(self.path)
        else:
            self._part.unlink(missing_ok=True)
