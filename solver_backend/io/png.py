"""Pictures as PNG (ISO/IEC 15948): grey with 8 or 16 bits, or colour with 8; also read again."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np

from solver_backend.exchange.errors import FileDamaged, FileMissing

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_SUB = 1
_LARGEST = 1 << 28
"""Bytes of a picture, unpacked."""


def png_bytes(picture: np.ndarray, *, noisy: bool = False) -> bytes:
    """Return an (h, w) uint8 or uint16 picture, or an (h, w, 3) uint8 one, as PNG.

    Args:
        picture: the picture.
        noisy: neighbours differ by noise, so that searching for repetitions is a waste of time.
    """
    height, width = picture.shape[:2]
    depth, kind = 8 * picture.dtype.itemsize, 2 if picture.ndim == 3 else 0
    step = picture.dtype.itemsize * (3 if picture.ndim == 3 else 1)
    raw = np.ascontiguousarray(picture if depth == 8 else picture.astype(">u2")).view(np.uint8).reshape(height, -1)
    rows = np.empty((height, 1 + raw.shape[1]), np.uint8)
    rows[:, 0] = _SUB
    rows[:, 1 : 1 + step] = raw[:, :step]
    np.subtract(raw[:, step:], raw[:, :-step], out=rows[:, 1 + step :])
    packer = zlib.compressobj(1, zlib.DEFLATED, 15, 9, zlib.Z_HUFFMAN_ONLY if noisy else zlib.Z_DEFAULT_STRATEGY)
    data = packer.compress(rows.tobytes()) + packer.flush()
    header = struct.pack(">IIBBBBB", width, height, depth, kind, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", data), (b"IEND", b""))
    return _SIGNATURE + b"".join(
        struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body)) for name, body in chunks
    )


def read_png(path: Path) -> np.ndarray:
    """Read a PNG that is grey (8 or 16 bits) or colour (8 bits, with or without alpha), not interlaced.

    Raises:
        FileMissing: it is not there.
        FileDamaged: it is no such file.
    """
    if not path.is_file():
        raise FileMissing("The picture is not there.", where=str(path))
    data = path.read_bytes()
    try:
        return _decoded(data)
    except (ValueError, KeyError, struct.error, zlib.error, IndexError) as error:
        raise FileDamaged("The picture is not a PNG of a kind we read.", where=str(path), hint=str(error)) from error


def _decoded(data: bytes) -> np.ndarray:
    if not data.startswith(_SIGNATURE):
        raise ValueError("another signature")
    at, parts, header = len(_SIGNATURE), list[bytes](), b""
    while at < len(data):
        (length,), name = struct.unpack(">I", data[at : at + 4]), data[at + 4 : at + 8]
        body = data[at + 8 : at + 8 + length]
        header = body if name == b"IHDR" else header
        parts += [body] if name == b"IDAT" else []
        at += 12 + length
    width, height, depth, kind, _, _, interlaced = struct.unpack(">IIBBBBB", header)
    channels = {0: 1, 2: 3, 6: 4}[kind]
    if depth not in (8, 16) or interlaced:
        raise ValueError("interlaced or of another depth")
    step = channels * depth // 8
    size = height * (1 + width * step)
    if not 0 < size <= _LARGEST:
        raise ValueError(f"{width} x {height} pixels")
    rows = np.frombuffer(_unpacked(b"".join(parts), size), np.uint8).reshape(height, 1 + width * step)
    raw = _unfiltered(rows[:, 0], rows[:, 1:].reshape(height, width, step))
    flat = raw.reshape(height, -1)
    values = flat.view(">u2").astype(np.uint16) if depth == 16 else flat
    return values.reshape(height, width, channels)[..., 0] if channels == 1 else values.reshape(height, width, channels)


def _unpacked(packed: bytes, size: int) -> bytes:
    """Return so many bytes; a picture that says it holds more is not unpacked any further."""
    data = zlib.decompressobj().decompress(packed, size)
    if len(data) < size:
        raise ValueError("cut off")
    return data


def _unfiltered(kinds: np.ndarray, rows: np.ndarray) -> np.ndarray:
    if (kinds == _SUB).all():
        return np.cumsum(rows, axis=1, dtype=np.uint8)
    out = np.zeros_like(rows)
    above = np.zeros_like(rows[0])
    for y, kind in enumerate(kinds.tolist()):
        if kind in (0, 1, 2):
            line = rows[y] if kind != 1 else np.cumsum(rows[y], axis=0, dtype=np.uint8)
            out[y] = line + above if kind == 2 else line
        else:
            out[y] = _by_pixel(kind, rows[y], above)
        above = out[y]
    return out


def _by_pixel(kind: int, row: np.ndarray, above: np.ndarray) -> np.ndarray:
    out = np.zeros_like(row)
    left, corner = np.zeros(row.shape[1], np.int32), np.zeros(row.shape[1], np.int32)
    for x in range(len(row)):
        up = above[x].astype(np.int32)
        if kind == 3:
            guess = (left + up) // 2
        else:
            p = left + up - corner
            a, b, c = np.abs(p - left), np.abs(p - up), np.abs(p - corner)
            guess = np.where((a <= b) & (a <= c), left, np.where(b <= c, up, corner))
        left = (row[x].astype(np.int32) + guess) & 255
        out[x], corner = left, up
    return out
