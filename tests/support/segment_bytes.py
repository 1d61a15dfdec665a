"""C3D files that hold rotations of segments and no points, as bytes."""

from __future__ import annotations

import struct

import numpy as np

SEGMENTS = ("worldbody_4X4", "pelvis_4X4", "l_thigh_4X4", "r_uarm_4X4")


def parameter(group: int, name: str, kind: int, dimensions: tuple[int, ...], data: bytes) -> bytes:
    body = struct.pack("<bB", kind, len(dimensions)) + bytes(dimensions) + data + b"\0"
    return struct.pack("<bb", len(name), group) + name.encode() + struct.pack("<h", 2 + len(body)) + body


def file_of(origins: np.ndarray, seen: np.ndarray, used: int = len(SEGMENTS)) -> bytes:
    """Return a file of (F, S, 3) origins in millimetres."""
    frames, width = len(origins), max(map(len, SEGMENTS))
    labels = "".join(name.ljust(width) for name in SEGMENTS).encode()
    records = b"".join([
        struct.pack("<bb", 5, -1) + b"POINT" + struct.pack("<hB", 3, 0),
        struct.pack("<bb", 8, -2) + b"ROTATION" + struct.pack("<hB", 3, 0),
        parameter(1, "USED", 2, (), struct.pack("<h", 0)),
        parameter(1, "UNITS", -1, (2,), b"mm"),
        parameter(1, "RATE", 4, (), struct.pack("<f", 85.0)),
        parameter(1, "FRAMES", 2, (), struct.pack("<h", frames)),
        parameter(2, "LABELS", -1, (width, len(SEGMENTS)), labels),
        parameter(2, "USED", 2, (), struct.pack("<h", used)),
        parameter(2, "RATE", 4, (), struct.pack("<f", 85.0)),
        parameter(2, "DATA_START", 2, (), struct.pack("<h", 4)),
    ])  # fmt: skip
    header = struct.pack("<BBHHHHHfHHf", 2, 0x50, 0, 0, 1, frames, 0, -1.0, 4, 0, 85.0)
    section = (b"\x01\x50\x02\x54" + records).ljust(1024, b"\0")
    matrices = np.tile(np.eye(4, dtype="<f4").T, (*origins.shape[:2], 1, 1))
    matrices[..., 3, :3] = origins
    words = np.concatenate([matrices.reshape(*origins.shape[:2], 16), np.where(seen, 0.0, -1.0)[..., None]], axis=-1)
    return header.ljust(512, b"\0") + section + words.astype("<f4").tobytes()
