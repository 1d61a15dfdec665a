"""Marker files read by one format's reader and interpreted, for the tests of formats."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

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


class Stated(NamedTuple):
    """What notes say about a file."""

    format: str
    frames: int
    unit: str
    up_axis: str
    analog_channels: tuple[str, ...]


def stated(take: MarkerTake) -> Stated:
    """Return the format, the unit, the up axis and the analog channels that the notes of a take name."""
    values = {(note.code, note.values.get("kind")): note.values for note in take.notes}
    channels = values.get(("parts_not_read", "analog"), {}).get("channels", ())
    axis = values["up_axis_read", None]["axis"].lower()
    read = values["markers_read", None]
    return Stated(read["format"], read["length"], values["unit_read", None]["unit"], axis, tuple(channels))
