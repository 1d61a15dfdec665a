"""A phone's QuickTime video as far as its metadata go, which name the lens."""

from __future__ import annotations

import struct
from pathlib import Path

KEY = b"com.apple.quicktime.camera.focal_length.35mm_equivalent"


def box(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I4s", 8 + len(content), kind) + content


def phone_video(path: Path, kind: int, value: bytes, track: bool = True, version: bytes = b"") -> Path:
    """Write the metadata of a phone's video, which its track carries, beside another entry."""
    names = (b"com.apple.quicktime.camera.lens_model", KEY)
    keys = bytes(4) + struct.pack(">I", len(names)) + b"".join(box(b"mdta", name) for name in names)
    data = [box(b"data", struct.pack(">II", t, 0) + v) for t, v in ((1, b"a lens"), (kind, value))]
    ilst = b"".join(box(struct.pack(">I", n + 1), item) for n, item in enumerate(data))
    meta = version + box(b"hdlr", bytes(8) + b"mdta" + bytes(13)) + box(b"keys", keys) + box(b"ilst", ilst)
    inner = box(b"meta", meta)
    path.write_bytes(
        box(b"ftyp", b"qt  ") + box(b"moov", box(b"trak", box(b"tkhd", bytes(84)) + inner) if track else inner)
    )
    return path
