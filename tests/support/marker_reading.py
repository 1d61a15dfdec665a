"""Marker files read by one format's reader and interpreted, for the tests of formats."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.io.interpretation import interpret_markers
from solver_backend.io.markers.source import MarkerSource, MarkerTake
from solver_backend.io.reader import ReadOptions


def taken(read: Callable[[Path], MarkerSource], path: Path, **options: Any) -> MarkerTake:
    """Return the markers of a file as a format's reader states them, with these reading options."""
    return interpret_markers(read(Path(path)), ReadOptions(**options))


def missing(take: MarkerTake) -> tuple[int, ...]:
    """Return in how many frames each marker is not seen."""
    return tuple(np.isnan(take.cloud.positions[..., 0]).sum(axis=0).tolist())
