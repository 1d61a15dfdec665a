"""Write and read PNG images (ISO/IEC 15948): greyscale with 8 or 16 bits, or colour with 8 bits."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np

from solver_backend.exchange.errors import FileDamaged, FileMissing
from solver_backend.io.files import read_bytes

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_SUB, _UP, _PAETH = 1, 2, 4
_LARGEST, _LONGEST_SIDE = 1 << 27, 1 << 15  # Size limit of an unpacked image in bytes, and of its sides in pixels.


def png_bytes(picture: np.ndarray, *, noisy: bool = False) -> bytes:
    """Encode an image (h, w) uint8 or uint16, or (h, w, 3) uint8, as PNG.

    ``noisy`` skips the search for repetitions, which noise does not contain.
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
    """Read a greyscale or colour PNG that is not interlaced. Raise FileMissing or FileDamaged."""
    if not path.is_file():
        raise FileMissing("The image does not exist.", where=str(path))
    data = read_bytes(path)
    try:
        return _decoded(data)
    except (ValueError, KeyError, struct.error, zlib.error, IndexError) as error:
        raise FileDamaged("The image is not a supported kind of PNG.", where=str(path), hint=str(error)) from error


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
    if not 0 < size <= _LARGEST or not 0 < width <= _LONGEST_SIDE or not 0 < height <= _LONGEST_SIDE:
        raise ValueError(f"{width} x {height} pixels")
    unpacked = zlib.decompressobj().decompress(b"".join(parts), size)
    if len(unpacked) < size:
        raise ValueError("cut off")
    rows = np.frombuffer(unpacked, np.uint8).reshape(height, 1 + width * step)
    raw = _unfiltered(rows[:, 0], rows[:, 1:].reshape(height, width, step))
    flat = raw.reshape(height, -1)
    values = flat.view(">u2").astype(np.uint16) if depth == 16 else flat
    return values.reshape((height, width) if channels == 1 else (height, width, channels))


def _unfiltered(kinds: np.ndarray, rows: np.ndarray) -> np.ndarray:
    if (kinds == _SUB).all():
        return np.cumsum(rows, axis=1, dtype=np.uint8)
    if kinds.max() > _PAETH:
        raise ValueError("an unknown filter")
    if kinds.max() > _UP:
        return _by_diagonals(kinds, rows)
    out = np.zeros_like(rows)
    above = np.zeros_like(rows[0])
    for y, kind in enumerate(kinds.tolist()):
        line = rows[y] if kind != _SUB else np.cumsum(rows[y], axis=0, dtype=np.uint8)
        out[y] = line + above if kind == _UP else line
        above = out[y]
    return out


def _by_diagonals(kinds: np.ndarray, rows: np.ndarray) -> np.ndarray:
    height, width, step = rows.shape
    out = np.zeros((height + 1, width + 1, step), np.uint8)
    for diagonal in range(height + width - 1):
        y = np.arange(max(0, diagonal - width + 1), min(height, diagonal + 1))
        x = diagonal - y
        left, up, corner = (out[places].astype(np.int16) for places in ((y + 1, x), (y, x + 1), (y, x)))
        a, b, c = np.abs(up - corner), np.abs(left - corner), np.abs(left + up - 2 * corner)
        paeth = np.where((a <= b) & (a <= c), left, np.where(b <= c, up, corner))
        guess = np.choose(kinds[y, None], (np.zeros_like(left), left, up, (left + up) // 2, paeth))
        out[y + 1, x + 1] = rows[y, x] + guess.astype(np.uint8)
    return out[1:, 1:]
