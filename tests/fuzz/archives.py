"""Archives written from members that are packed already, so that only what changes is packed anew."""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

_LONG_AGO = 0x21  # 1 January 1980 in the days of DOS, so that the same members are the same bytes.
_STORED, _DEFLATED = 0, 8
_MADE_BY, _WITH_UTF8 = 20, 0x800


@dataclass(frozen=True)
class Member:
    """One file of an archive."""

    name: str
    content: bytes
    """As it is packed."""
    size: int
    """Unpacked."""
    crc: int
    method: int


def member(name: str, content: bytes, packed: bool = False) -> Member:
    """Return a member, deflated or as it is."""
    method, held = _STORED, content
    if packed:
        deflate = zlib.compressobj(1, zlib.DEFLATED, -15)
        method, held = _DEFLATED, deflate.compress(content) + deflate.flush()
    return Member(name, held, len(content), zlib.crc32(content), method)


def archive_bytes(members: Iterable[Member]) -> bytes:
    """Return a ZIP archive of them (PKWARE's APPNOTE 6.3.10, sections 4.3.7, 4.3.12 and 4.3.16)."""
    parts: list[bytes] = []
    index: list[bytes] = []
    at = 0
    for one in members:
        name = one.name.encode()
        sizes = struct.pack("<IIIHH", one.crc, len(one.content), one.size, len(name), 0)
        about = struct.pack("<HHHHH", _MADE_BY, _WITH_UTF8, one.method, 0, _LONG_AGO) + sizes
        parts += [b"PK\x03\x04", about, name, one.content]
        index.append(b"PK\x01\x02" + struct.pack("<H", _MADE_BY) + about + struct.pack("<HHHII", 0, 0, 0, 0, at) + name)
        at += 4 + len(about) + len(name) + len(one.content)
    whole = b"".join(index)
    end = struct.pack("<HHHHIIH", 0, 0, len(index), len(index), len(whole), at, 0)
    return b"".join([*parts, whole, b"PK\x05\x06", end])


def npy_bytes(array: np.ndarray) -> bytes:
    """Return an array as a member of an archive has it."""
    content = io.BytesIO()
    np.save(content, array)
    return content.getvalue()
