"""What git calls a folder: the SHA-1 that a commit is bound to, worked out from the files, without any history."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping


def tree_id(files: Mapping[str, bytes]) -> str:
    """As `git rev-parse COMMIT:FOLDER` prints it. files: contents by path below the folder; none is executable."""
    return _tree(files).hex()


def _tree(files: Mapping[str, bytes]) -> bytes:
    folders: dict[str, dict[str, bytes]] = {}
    entries = {}
    for path, content in files.items():
        name, _, below = path.partition("/")
        if below:
            folders.setdefault(name, {})[below] = content
        else:
            entries[name] = b"100644 " + name.encode() + b"\0" + _object("blob", content)
    for name, inner in folders.items():
        entries[f"{name}/"] = b"40000 " + name.encode() + b"\0" + _tree(inner)
    return _object("tree", b"".join(entry for _, entry in sorted(entries.items())))  # a folder sorts as with its slash


def _object(kind: str, content: bytes) -> bytes:
    return hashlib.sha1(f"{kind} {len(content)}\0".encode() + content, usedforsecurity=False).digest()
