"""Grammars of binary files: archives of arrays, pickles, pictures, boxes of videos, and words of two bytes."""

from __future__ import annotations

import io
import pickle
import struct
import zipfile
import zlib
from typing import Any

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from tests.fuzz.grammars.values import ODDLY, TREES, oddly

_KINDS = ("<f8", "<f4", "<i4", "<i8", "|b1", "<U5", "|S3", "<f2", ">f8", "<u2")
_SHAPES = arrays.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=5)
_BOXES = {b"moov", b"trak", b"mdia", b"minf", b"stbl", b"edts", b"udta"}
_NAMES_IN_BODIES = (
    "v_template", "f", "J", "weights", "shapedirs", "posedirs", "kintree_table", "J_regressor",
)  # fmt: skip
_ODD_CHUNKS = [b"tEXt", b"gAMA", b"tRNS", b"ABCD", b"IHDR"]
_LIMITS = st.sampled_from([0, 1, 2, 0x7F, 0xFF, 0x7FFF, 0x8000, 0xFFFF]) | st.integers(0, 0xFFFF)


def is_archive(data: bytes) -> bool:
    """Return whether NumPy reads all of an archive."""
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as archive:
            return all(archive[name].dtype.hasobject is False for name in archive.files)
    except Exception:  # whatever is wrong with an odd file
        return False


@st.composite
def npz_bytes(draw: st.DrawFn, sound: bytes) -> bytes:
    """Draw an archive that any NumPy reads: members of other shapes, types or values, left out or added."""
    with np.load(io.BytesIO(sound), allow_pickle=False) as archive:
        members = {name: archive[name] for name in archive.files}
    out, packing = io.BytesIO(), draw(st.sampled_from([zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED]))
    with zipfile.ZipFile(out, "w", packing) as archive:
        for name, value in members.items():
            what = draw(st.integers(0, 2 * ODDLY))
            if what == 0:
                continue
            value = draw(_array_like(value)) if what < 16 else value
            content = io.BytesIO()
            np.save(content, value)
            member = zipfile.ZipInfo(f"{name}.npy")  # of a day long ago, so that a number names the same bytes
            archive.writestr(member, content.getvalue(), packing)
    return out.getvalue()


@st.composite
def _array_like(draw: st.DrawFn, sound: np.ndarray) -> np.ndarray:
    what = draw(st.integers(0, 4))
    if what == 0:
        return draw(arrays.arrays(st.sampled_from(_KINDS).map(np.dtype), _SHAPES))
    if what == 1 and sound.ndim:
        axis = draw(st.integers(0, sound.ndim - 1))
        return np.take(sound, range(draw(st.integers(0, sound.shape[axis]))), axis=axis)
    if sound.dtype.kind == "f" and sound.size:
        changed = sound.copy()
        with np.errstate(all="ignore"):
            changed.reshape(-1)[draw(st.integers(0, sound.size - 1))] = draw(st.floats())
        return changed
    if sound.dtype.kind in "iub" and sound.size:
        with np.errstate(all="ignore"):
            return (sound.astype(np.int64) + draw(st.integers(-3, 3) | st.sampled_from([2**31, -(2**40)]))).astype(
                draw(st.sampled_from([sound.dtype, np.dtype("<i8")]))
            )
    return np.array(draw(st.text(max_size=12)))


@st.composite
def pickle_bytes(draw: st.DrawFn, sound: bytes) -> bytes:
    """Draw a pickle, of any protocol, of a dictionary of arrays, lists and words under the names that bodies have."""
    found: dict[Any, Any] = {}
    for name in _NAMES_IN_BODIES:
        if draw(st.integers(0, ODDLY)):
            found[name] = draw(
                arrays.arrays(st.sampled_from(_KINDS[:4]).map(np.dtype), _SHAPES) | TREES
            )  # fmt: skip
    return pickle.dumps(draw(oddly(found, TREES)), protocol=draw(st.integers(0, 5)))


@st.composite
def png_bytes(draw: st.DrawFn, sound: bytes) -> bytes:
    """Draw a picture: a header, lines of its size or of another, chunks that pictures may have, sums that are right."""
    width, height = draw(st.integers(0, 6)), draw(st.integers(0, 6))
    depth, colour = draw(oddly(8, st.sampled_from([1, 2, 4, 16, 3]))), draw(oddly(2, st.sampled_from([0, 3, 4, 6, 7])))
    head = struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, draw(oddly(0, st.integers(1, 2))))
    samples = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}.get(colour, 3)
    line = (width * samples * depth + 7) // 8 + 1
    lines = bytearray(draw(st.binary(min_size=line * height, max_size=line * height)))
    for row in range(height):
        lines[row * line] = draw(oddly(row % 5, st.integers(5, 255)))
    parts = [(b"IHDR", head), (b"IDAT", zlib.compress(bytes(lines)[: draw(oddly(len(lines), st.integers(0, 40)))]))]
    if colour == 3:
        parts.insert(1, (b"PLTE", draw(st.binary(max_size=30))))
    if draw(st.integers(0, 5)) == 0:
        parts.insert(1, (draw(st.sampled_from(_ODD_CHUNKS)), draw(st.binary(max_size=9))))
    parts.append((b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body)) for name, body in parts
    )


@st.composite
def box_bytes(draw: st.DrawFn, sound: bytes) -> bytes:
    """Draw a file of boxes in boxes, as videos are: left out, repeated, of other sizes, with other numbers in them."""
    return _boxes(draw, sound)


def _boxes(draw: st.DrawFn, data: bytes) -> bytes:
    out, at = b"", 0
    while at + 8 <= len(data):
        size, kind = struct.unpack_from(">I4s", data, at)
        size = size if 8 <= size <= len(data) - at else len(data) - at
        body = data[at + 8 : at + size]
        body = _boxes(draw, body) if kind in _BOXES else _with_words(draw, body, 2 * ODDLY)
        length = draw(oddly(8 + len(body), st.integers(0, 2**32 - 1)))
        times = draw(oddly(1, st.integers(0, 3)))
        out, at = out + (struct.pack(">I4s", length, kind) + body) * times, at + size
    return out + data[at:]


@st.composite
def word_bytes(draw: st.DrawFn, sound: bytes) -> bytes:
    """Draw the same words of two bytes, some of them others: what C3D's header, parameters and data are made of."""
    head = min(len(sound), 1536)
    return _with_words(draw, sound[:head], 1) + sound[head:][: draw(oddly(len(sound), st.integers(0, len(sound))))]


def _with_words(draw: st.DrawFn, data: bytes, seldom: int) -> bytes:
    if len(data) < 2 or draw(st.integers(0, seldom)) > 1:
        return data
    changed = bytearray(data)
    for _ in range(draw(st.integers(1, 3))):
        at = 2 * draw(st.integers(0, len(data) // 2 - 1))
        changed[at : at + 2] = draw(_LIMITS).to_bytes(2, draw(st.sampled_from(["little", "big"])))
    return bytes(changed)
