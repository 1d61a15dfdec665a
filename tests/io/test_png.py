"""Pictures packed by every filter that the format knows, read within seconds whatever they claim."""

from __future__ import annotations

import struct
import time
import zlib
from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.errors import FileDamaged
from solver_backend.io.png import read_png


def chunk(name: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))


def write(path: Path, width: int, height: int, rows: bytes, depth: int = 8, kind: int = 0) -> Path:
    head = struct.pack(">IIBBBBB", width, height, depth, kind, 0, 0, 0)
    chunks = chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunks)
    return path


def unfiltered(rows: np.ndarray, step: int) -> np.ndarray:
    """Return the bytes of filtered rows, one after the other as ISO/IEC 15948 says it in chapter 9."""
    out = np.zeros((len(rows), rows.shape[1] - 1), dtype=int)
    for y, (kind, *line) in enumerate(rows.tolist()):
        for i, value in enumerate(line):
            a = int(out[y, i - step]) if i >= step else 0
            b = int(out[y - 1, i]) if y else 0
            c = int(out[y - 1, i - step]) if y and i >= step else 0
            nearest = min((abs(b - c), 0, a), (abs(a - c), 1, b), (abs(a + b - 2 * c), 2, c))[2]
            out[y, i] = (value + (0, a, b, (a + b) // 2, nearest)[kind]) & 255
    return out.astype(np.uint8)


@pytest.mark.parametrize(("depth", "kind", "step"), [(8, 0, 1), (8, 2, 3), (16, 0, 2), (8, 6, 4)])
@pytest.mark.parametrize("filters", [(0, 1, 2), (0, 1, 2, 3, 4), (4,)])
def test_rows_of_every_filter_are_read(
    depth: int, kind: int, step: int, filters: tuple[int, ...], tmp_path: Path
) -> None:
    rng = np.random.default_rng(3)
    rows = rng.integers(0, 256, (11, 1 + 7 * step)).astype(np.uint8)
    rows[:, 0] = rng.choice(filters, len(rows))
    true = unfiltered(rows, step)
    true = true.view(">u2") if depth == 16 else true
    read = read_png(write(tmp_path / "a.png", 7, 11, rows.tobytes(), depth, kind))
    assert read.dtype == (np.uint16 if depth == 16 else np.uint8)
    assert (read.reshape(11, -1) == true).all()


def test_a_small_file_of_many_pixels_keeps_nobody_waiting(tmp_path: Path) -> None:
    path = write(tmp_path / "a.png", 2000, 1000, (bytes([4]) + bytes(2000)) * 1000)
    assert path.stat().st_size < 10_000
    begun = time.process_time()
    assert read_png(path).shape == (1000, 2000)
    assert time.process_time() - begun < 5.0


@pytest.mark.parametrize(
    ("width", "height", "rows"), [(1, 100_000, bytes(200_000)), (100_000, 1, bytes(100_001)), (1, 1, bytes([5, 0]))]
)
def test_sides_that_no_sensor_has_and_unknown_filters_are_named(
    width: int, height: int, rows: bytes, tmp_path: Path
) -> None:
    with pytest.raises(FileDamaged, match="not a supported kind of PNG"):
        read_png(write(tmp_path / "a.png", width, height, rows))
