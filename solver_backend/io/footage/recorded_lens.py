"""The focal length that a camera wrote into its file: Exif of a JPEG picture, metadata of a QuickTime video."""

from __future__ import annotations

import math
import struct
from contextlib import suppress
from pathlib import Path

from solver_backend.exchange.regular_file import open_regular
from solver_backend.io.footage.mp4 import boxes, inside, top_level_box

PICTURES = (".jpg", ".jpeg")
_MOST_EXIF = 1 << 16
"""Bytes of a JPEG segment at most."""
_MOST_SEGMENTS = 64
_EXIF_POINTER, _FOCAL_35MM = 0x8769, 0xA405
"""Tags of Exif 2.32: of the list of the camera's own entries, and FocalLengthIn35mmFilm."""
_QUICKTIME_KEY = b"com.apple.quicktime.camera.focal_length.35mm_equivalent"
_FORMATS = {21: {1: ">b", 2: ">h", 4: ">i", 8: ">q"}, 22: {1: ">B", 2: ">H", 4: ">I", 8: ">Q"}, 23: {4: ">f"},
            24: {8: ">d"}, 65: {1: ">b"}, 66: {2: ">h"}, 67: {4: ">i"}, 74: {8: ">q"}, 75: {1: ">B"}, 76: {2: ">H"},
            77: {4: ">I"}, 78: {8: ">Q"}}  # fmt: skip
"""Number formats by their type and length (QuickTime File Format, well-known types)."""
PLAUSIBLE_MM = (8.0, 1000.0)
"""From fisheye to telescope; what lies beyond is no focal length."""


def recorded_focal_mm(footage: Path) -> float | None:
    """Return the 35 mm equivalent of the focal length in the metadata of a video, or a folder's first picture.

    Args:
        footage: a video, a picture, or a folder of pictures.

    Returns:
        Millimetres; None where the file states none that can be.
    """
    if footage.is_dir():
        pictures = sorted(path for path in footage.iterdir() if path.suffix.lower() in PICTURES)
        return recorded_focal_mm(pictures[0]) if pictures else None
    with suppress(OSError, struct.error, IndexError, ValueError, OverflowError):
        read = _of_jpeg if footage.suffix.lower() in PICTURES else _of_quicktime
        found = read(footage)
        if found is not None and math.isfinite(found) and PLAUSIBLE_MM[0] <= found <= PLAUSIBLE_MM[1]:
            return float(found)
    return None


def _of_jpeg(path: Path) -> float | None:
    with open_regular(path) as stream:
        if stream.read(2) != b"\xff\xd8":
            return None
        for _ in range(_MOST_SEGMENTS):
            marker, size = struct.unpack(">HH", stream.read(4))
            content = stream.read(min(size - 2, _MOST_EXIF))
            if marker == 0xFFE1 and content[:6] == b"Exif\0\0":
                return _of_tiff(content[6:])
            if marker == 0xFFDA:  # the picture itself begins
                return None
    return None


def _of_tiff(data: bytes) -> float | None:
    order = {b"II": "<", b"MM": ">"}[data[:2]] if data[:2] in (b"II", b"MM") else ""
    if not order:
        return None
    pointer = _entry(data, struct.unpack_from(f"{order}I", data, 4)[0], _EXIF_POINTER, order)
    return None if pointer is None else _entry(data, pointer, _FOCAL_35MM, order)


def _entry(data: bytes, at: int, wanted: int, order: str) -> int | None:
    """Return the value of a short or long entry of the list at this byte."""
    for n in range(struct.unpack_from(f"{order}H", data, at)[0]):
        tag, kind = struct.unpack_from(f"{order}HH", data, at + 2 + 12 * n)
        if tag == wanted and kind in (3, 4):
            return int(struct.unpack_from(f"{order}{'H' if kind == 3 else 'I'}", data, at + 10 + 12 * n)[0])
    return None


def _of_quicktime(path: Path) -> float | None:
    with open_regular(path) as stream:
        moov = top_level_box(stream, b"moov")
    if moov is None:
        return None
    whole = memoryview(moov)
    places = [whole, *(content for kind, content in boxes(whole) if kind == b"trak")]
    held = (inside(place, *way) for place in places for way in ((b"meta",), (b"udta", b"meta")))
    return next((mm for meta in held if (mm := _of_metadata(meta)) is not None), None)


def _of_metadata(meta: memoryview) -> float | None:
    meta = meta[4:] if bytes(meta[8:12]) == b"hdlr" else meta  # ISO's begins with a version, QuickTime's does not
    keys, values = inside(meta, b"keys"), inside(meta, b"ilst")
    names = [bytes(name) for _, name in boxes(keys[8:])]
    if _QUICKTIME_KEY not in names:
        return None
    wanted = struct.pack(">I", 1 + names.index(_QUICKTIME_KEY))
    data = inside(next((content for kind, content in boxes(values) if kind == wanted), memoryview(b"")), b"data")
    kind, value = struct.unpack_from(">I", data, 0)[0], bytes(data[8:])
    if kind == 1:
        return float(value.decode("ascii", "replace"))
    layout = _FORMATS.get(kind, {}).get(len(value))
    return None if layout is None else float(struct.unpack(layout, value)[0])
