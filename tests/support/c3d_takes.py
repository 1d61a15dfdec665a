"""Takes of a few markers above each other, written as C3D and read back."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from solver_backend.io.markers.c3d import read_c3d
from solver_backend.io.markers.source import MarkerTake
from tests.support.c3d_bytes import C3dBytes
from tests.support.marker_reading import taken

LABELS = ("LFHD", "C7", "LANK", "LTOE")


def standing(frames: int = 12, labels: tuple[str, ...] = LABELS) -> np.ndarray:
    """Return (F, M, 3) millimetres, in whole tenths, of markers above each other that walk along x."""
    points = np.zeros((frames, len(labels), 3))
    points[..., 2] = np.linspace(1700, 30, len(labels)).round(1)
    points[..., 0] = np.arange(frames)[:, None] * 12.3 + np.arange(len(labels))
    points[..., 1] = -45.7
    return points


def take(path: Path, file: C3dBytes, **options: float | str) -> MarkerTake:
    path.write_bytes(file.to_bytes())
    return taken(read_c3d, path, **options)  # type: ignore[arg-type]
