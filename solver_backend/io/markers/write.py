"""Markers to files of every format; a new one is a writer, a row here and one in ``MARKER_FORMATS``."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from solver_backend.io.markers.c3d_writer import write_c3d
from solver_backend.io.markers.trc_writer import write_trc
from solver_backend.types import MarkerCloud

WRITERS: dict[str, Callable[..., Path]] = {"c3d": write_c3d, "trc": write_trc}
"""By the ending of the files."""


def write_markers(path: Path, cloud: MarkerCloud, *, overwrite: bool = False) -> Path:
    """Write markers in the format that the path's ending names.

    Args:
        path: ends in one of ``WRITERS``.
        cloud: markers, Z up, in metres.
        overwrite: replace a file that is there.

    Raises:
        OutputExists, OutputNotWritable: see ``atomic_output``.
        NonFiniteData, ShapeMismatch: the format cannot hold them, see its writer.
    """
    return WRITERS[path.suffix.lower().lstrip(".")](path, cloud, overwrite=overwrite)
