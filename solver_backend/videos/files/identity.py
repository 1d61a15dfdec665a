"""Which file a video is, whatever its name: a hash of its bytes."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path

from solver_backend.videos.files.errors import SameVideoTwice

_PIECE = 1 << 22
"""Bytes that are read at a time; chosen by hand."""


def file_hash(path: Path | str) -> str:
    """Return the BLAKE2b hash of a file's bytes, 16 bytes in hexadecimal."""
    digest = hashlib.blake2b(digest_size=16)
    with open(path, "rb") as stream:
        while piece := stream.read(_PIECE):
            digest.update(piece)
    return digest.hexdigest()


def recording_hash(parts: Sequence[Path]) -> str:
    """Return the hash of a recording's files in their order; that of the file where it is one."""
    if len(parts) == 1:
        return file_hash(parts[0])
    return hashlib.blake2b("".join(map(file_hash, parts)).encode(), digest_size=16).hexdigest()


def require_different(hashes: Mapping[Path, str]) -> None:
    """Check that no two videos have the same bytes.

    Raises:
        SameVideoTwice: two have; names both.
    """
    first: dict[str, Path] = {}
    for path, digest in hashes.items():
        if digest in first:
            raise SameVideoTwice(
                f"{first[digest].name} and {path.name} are the same video.", where=str(path),
                hint="Two cameras cannot have filmed the same pictures: copy the second camera's video again.",
            )  # fmt: skip
        first[digest] = path
