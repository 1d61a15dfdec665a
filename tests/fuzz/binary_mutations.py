"""Changes of pickles by their operations, of pictures by their chunks, of other binary files by their numbers."""

from __future__ import annotations

import pickletools
import struct
import zlib

import numpy as np

_NUMBERS = (0, 1, 2, 127, 128, 255, 256, 32767, 32768, 65535, 2**31 - 1, 2**31, 2**32 - 1, 2**63 - 1, 2**63, 2**64 - 1)
_ODD_FLOATS = (np.nan, np.inf, -1.0, 1e300, 1e-300)
_HEAD = 1200
"""Bytes in which formats keep their headers."""
_ODD_OPERATIONS = (
    b"0", b"1", b"2", b"(", b"t", b"]", b"}", b"R", b"b", b"s", b"u", b"a", b"e", b"\x85", b"\x86", b"\x87", b"\x81",
    b"N", b"K\xff", b"M\xff\xff", b"J\xff\xff\xff\xff", b"\x8a\x09" + b"\xff" * 8 + b"\x7f", b"h\x00", b"q\x00",
    b"r\xff\xff\xff\x7f", b"j\xff\xff\xff\x7f", b"cnumpy\nndarray\n", b"cnumpy\ndtype\n", b"cbuiltins\neval\n",
    b"cnumpy.core.multiarray\n_reconstruct\n", b"X\xff\xff\xff\x7f", b"B\xff\xff\xff\xff", b".",
)  # fmt: skip


def change_numbers(data: bytes, rng: np.random.Generator) -> bytes:
    """Replace a number of 1, 2, 4 or 8 bytes, mostly in the head, by one at a limit."""
    if not data:
        return rng.bytes(8)
    reach = min(len(data), _HEAD) if rng.random() < 0.8 else len(data)
    at, width = int(rng.integers(reach)), 1 << int(rng.integers(4))
    number = _NUMBERS[int(rng.integers(len(_NUMBERS)))]
    if rng.random() < 0.2:
        piece = struct.pack("<d", _ODD_FLOATS[int(rng.integers(len(_ODD_FLOATS)))])[-width:]
    else:
        piece = (number % 256**width).to_bytes(width, "little" if rng.random() < 0.5 else "big")
    return data[:at] + piece + data[at + width :]


def change_pickle(data: bytes, rng: np.random.Generator) -> bytes:
    """Remove, repeat, exchange or insert operations, or change bytes of one; what is broken is changed as numbers."""
    try:
        starts = [at for _, _, at in pickletools.genops(data)]
    except Exception:  # what earlier changes have broken
        return change_numbers(data, rng)
    pieces = [data[a:b] for a, b in zip(starts, [*starts[1:], len(data)], strict=True)]
    i, j = (int(rng.integers(len(pieces))) for _ in range(2))
    what = int(rng.integers(6))
    if what == 0:
        del pieces[i]
    elif what == 1:
        pieces[i:i] = pieces[i : i + int(rng.integers(1, 20))] * int(rng.integers(1, 30))
    elif what == 2:
        pieces[i], pieces[j] = pieces[j], pieces[i]
    elif what <= 4:
        pieces.insert(i, _ODD_OPERATIONS[int(rng.integers(len(_ODD_OPERATIONS)))])
    else:
        pieces[i] = change_numbers(pieces[i], rng)
    return b"".join(pieces)


def change_png(data: bytes, rng: np.random.Generator) -> bytes:
    """Change what a picture's chunks hold, packed and summed anew; what is broken is changed as numbers."""
    try:
        chunks = _chunks(data)
        at = int(rng.integers(len(chunks)))
        name, body = chunks[at]
        what = int(rng.integers(5))
        if what == 0:
            del chunks[at]
        elif what == 1:
            chunks.insert(int(rng.integers(len(chunks))), chunks[at])
        elif name == b"IDAT" and what < 4:
            chunks[at] = name, zlib.compress(change_numbers(zlib.decompress(body), rng))
        else:
            chunks[at] = name, change_numbers(body, rng)
    except (struct.error, zlib.error, ValueError):
        return change_numbers(data, rng)
    return data[:8] + b"".join(
        struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body)) for name, body in chunks
    )


def _chunks(data: bytes) -> list[tuple[bytes, bytes]]:
    found, at = [], 8
    while at < len(data):
        (length,) = struct.unpack_from(">I", data, at)
        found.append((data[at + 4 : at + 8], data[at + 8 : at + 8 + length]))
        at += 12 + length
    return found
