"""Grammars of binary files: archives of arrays, pickles, pictures, boxes of videos, and words of two bytes."""

from __future__ import annotations

import io
import pickle
import struct
import zlib
from typing import Any

import numpy as np

from tests.fuzz.archives import Member, archive_bytes, member
from tests.fuzz.grammars.draws import Draw
from tests.fuzz.grammars.values import ODDLY

_BOXES = {b"moov", b"trak", b"mdia", b"minf", b"stbl", b"edts", b"udta"}
_NAMES_IN_BODIES = (
    "v_template", "f", "J", "weights", "shapedirs", "posedirs", "kintree_table", "J_regressor",
)  # fmt: skip
_ODD_CHUNKS = [b"tEXt", b"gAMA", b"tRNS", b"ABCD", b"IHDR"]
_LIMITS = [0, 1, 2, 0x7F, 0xFF, 0x7FFF, 0x8000, 0xFFFF]


def members_of(data: bytes) -> list[tuple[np.ndarray, Member]]:
    """Return the arrays of an archive and how they are packed; nothing where NumPy does not read all of it."""
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    except Exception:  # whatever is wrong with an odd file
        return []
    if any(not isinstance(array, np.ndarray) or array.dtype.hasobject for array in arrays.values()):
        return []
    return [(array, member(f"{name}.npy", npy_bytes(array))) for name, array in arrays.items()]


def npy_bytes(array: np.ndarray) -> bytes:
    """Return an array as a member of an archive has it."""
    content = io.BytesIO()
    np.save(content, array)
    return content.getvalue()


def npz_bytes(draw: Draw, members: list[tuple[np.ndarray, Member]]) -> bytes:
    """Draw an archive that any NumPy reads: members of other shapes, types or values, or left out; often one alone."""
    kept, packed, alone = [], draw.seldom(2), draw.integer(0, len(members) - 1) if draw.seldom(2) else -1
    for number, (array, whole) in enumerate(members):
        what = draw.integer(0, 2 * ODDLY) if alone < 0 or alone == number else 2 * ODDLY
        if 0 < what < (2 * ODDLY if alone == number else 16):
            kept.append(member(whole.name, npy_bytes(_array_like(draw, array)), packed))
        elif what:
            kept.append(whole)
    return archive_bytes(kept)


def _array_like(draw: Draw, sound: np.ndarray) -> np.ndarray:
    what = draw.integer(0, 4)
    if what == 0:
        return draw.value("array")
    if what == 1 and sound.ndim:
        axis = draw.integer(0, sound.ndim - 1)
        return np.take(sound, range(draw.integer(0, sound.shape[axis])), axis=axis)
    if sound.dtype.kind == "f" and sound.size:
        changed = sound.copy()
        with np.errstate(all="ignore"):
            changed.reshape(-1)[draw.integer(0, sound.size - 1)] = draw.value("float")
        return changed
    if sound.dtype.kind in "iub" and sound.size:
        step = draw.one_of([-3, -2, -1, 0, 1, 2, 3, 2**31, -(2**40)])
        with np.errstate(all="ignore"):
            return (sound.astype(np.int64) + step).astype(draw.one_of([sound.dtype, np.dtype("<i8")]))
    return np.array(draw.value("text"))


def pickle_bytes(draw: Draw) -> bytes:
    """Draw a pickle, of any protocol, of a dictionary of arrays, lists and words under the names that bodies have."""
    found: dict[Any, Any] = {}
    for name in _NAMES_IN_BODIES:
        if not draw.seldom():
            found[name] = draw.value("plain array" if draw.seldom(2) else "tree")
    return pickle.dumps(draw.oddly(found, "tree"), protocol=draw.integer(0, 5))


def png_bytes(draw: Draw) -> bytes:
    """Draw a picture: a header, lines of its size or of another, chunks that pictures may have, sums that are right."""
    width, height = draw.integer(0, 6), draw.integer(0, 6)
    depth, colour = draw.oddly(8, [1, 2, 4, 16, 3]), draw.oddly(2, [0, 3, 4, 6, 7])
    head = struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, draw.oddly(0, [1, 2]))
    samples = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}.get(colour, 3)
    line = (width * samples * depth + 7) // 8 + 1
    lines = bytearray(draw.content(line * height))
    for row in range(height):
        lines[row * line] = draw.oddly(row % 5, range(5, 256))
    length = draw.oddly(len(lines), range(41))
    parts = [(b"IHDR", head), (b"IDAT", zlib.compress(bytes(lines)[:length]))]
    if colour == 3:
        parts.insert(1, (b"PLTE", draw.content(draw.integer(0, 30))))
    if draw.seldom(6):
        parts.insert(1, (draw.one_of(_ODD_CHUNKS), draw.content(draw.integer(0, 9))))
    parts.append((b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body)) for name, body in parts
    )


def box_bytes(draw: Draw, data: bytes) -> bytes:
    """Draw a file of boxes in boxes, as videos are: left out, repeated, of other sizes, with other numbers in them."""
    out, at = b"", 0
    while at + 8 <= len(data):
        size, kind = struct.unpack_from(">I4s", data, at)
        size = size if 8 <= size <= len(data) - at else len(data) - at
        body = data[at + 8 : at + size]
        body = box_bytes(draw, body) if kind in _BOXES else _with_words(draw, body, 2 * ODDLY)
        length = draw.integer(0, 2**32 - 1) if draw.seldom() else 8 + len(body)
        times = draw.oddly(1, [0, 1, 2, 3])
        out, at = out + (struct.pack(">I4s", length % 2**32, kind) + body) * times, at + size
    return out + data[at:]


def word_bytes(draw: Draw, data: bytes) -> bytes:
    """Draw the same words of two bytes, some of them others: what C3D's header, parameters and data are made of."""
    head = min(len(data), 1536)
    length = draw.integer(0, len(data)) if draw.seldom() else len(data)
    return _with_words(draw, data[:head], 1) + data[head:][:length]


def _with_words(draw: Draw, data: bytes, seldom: int) -> bytes:
    if len(data) < 2 or draw.integer(0, seldom) > 1:
        return data
    changed = bytearray(data)
    for _ in range(draw.integer(1, 3)):
        at = 2 * draw.integer(0, len(data) // 2 - 1)
        word = draw.one_of(_LIMITS) if draw.seldom(2) else draw.integer(0, 0xFFFF)
        changed[at : at + 2] = word.to_bytes(2, draw.one_of(["little", "big"]))
    return bytes(changed)
