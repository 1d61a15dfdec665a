"""MATLAB files of Qualisys Track Manager as bytes, without SciPy."""

from __future__ import annotations

import struct
import zlib

import numpy as np


def _element(kind: int, data: bytes) -> bytes:
    return struct.pack("<II", kind, len(data)) + data.ljust(-(-len(data) // 8) * 8, b"\0")


def _matrix(kind: int, shape: tuple[int, ...], parts: bytes, name: str = "") -> bytes:
    head = _element(6, struct.pack("<II", kind, 0)) + _element(5, struct.pack(f"<{len(shape)}i", *shape))
    return _element(14, head + _element(1, name.encode()) + parts)


def _value(value: object, name: str = "") -> bytes:
    if isinstance(value, dict):
        names = b"".join(key.encode().ljust(32, b"\0") for key in value)
        parts = _element(5, struct.pack("<i", 32)) + _element(1, names)
        return _matrix(2, (1, 1), parts + b"".join(map(_value, value.values())), name)
    if isinstance(value, str):
        return _matrix(4, (1, len(value)), _element(16, value.encode()), name)
    if isinstance(value, list):
        return _matrix(1, (1, len(value)), b"".join(map(_value, value)), name)
    array = np.atleast_2d(np.asarray(value, np.float64))
    return _matrix(6, array.shape, _element(9, array.tobytes(order="F")), name)


def mat_of_qtm(frames: int = 5, *, packed: bool = False) -> bytes:
    """Return a file of two labelled trajectories and a stray one, in millimetres."""
    data = np.random.default_rng(3).uniform(-900, 900, (3, 4, frames))
    labeled = {"Count": 2, "Labels": ["C7", "LTOE"], "Data": data[:2]}
    tracks = {"Labeled": labeled, "Unidentified": {"Count": 1, "Data": data[2:]}}
    body = _value({"File": "walk.qtm", "Frames": frames, "FrameRate": 200, "Trajectories": tracks}, "walk")
    if packed:
        content = zlib.compress(body)
        body = struct.pack("<II", 15, len(content)) + content
    return b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" + body


def mat_with_an_object() -> bytes:
    """Return a file of a number x, a string object s and a number y."""
    head = _element(6, struct.pack("<II", 17, 0)) + _element(1, b"s") + _element(1, b"MCOS") + _element(1, b"string")
    body = _value(1.0, "x") + _element(14, head + _value([3.0])) + _value(2.0, "y")
    return b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" + body
