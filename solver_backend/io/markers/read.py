"""Read and write marker files in all supported formats."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from solver_backend.exchange.errors import CaptureNotRecognised
from solver_backend.exchange.outputs import require_file
from solver_backend.io.files import as_text, first_bytes
from solver_backend.io.interpretation import MARKER_OPTIONS, interpret_markers
from solver_backend.io.markers.c3d import read_c3d, write_c3d
from solver_backend.io.markers.camera_systems import (
    FILE_TYPE,
    FIRST_LINE,
    begins_as_motive,
    read_motive_csv,
    read_nexus_csv,
    read_qualisys_mat,
    read_qualisys_tsv,
    read_trc,
    sections_of,
    write_trc,
)
from solver_backend.io.markers.live_recording import SUFFIX, read_live_recording
from solver_backend.io.markers.point_table import begins_as_points, is_point_array, read_point_array, read_point_table
from solver_backend.io.markers.source import MarkerSource, MarkerTake
from solver_backend.io.reader import Reader, ReadOptions
from solver_backend.types import MarkerCloud

_HEAD_BYTES = 65536  # Number of bytes read to recognise a file's format.


def _row(
    kind: str,
    suffixes: tuple[str, ...],
    read: Callable[[Path], MarkerSource],
    begins: Callable[[str], bool] | None = None,
) -> Reader[MarkerTake]:
    def recognises(path: Path) -> bool:
        if path.suffix.lower() not in suffixes or not path.is_file():
            return False
        return begins is None or begins(as_text(first_bytes(path, _HEAD_BYTES)).lstrip(' "\r\n\t'))

    return _interpreted(f"{kind} ({', '.join(suffixes)})", recognises, read)


def _interpreted(
    kind: str, recognises: Callable[[Path], bool], read: Callable[[Path], MarkerSource]
) -> Reader[MarkerTake]:
    return Reader(kind, recognises, lambda path, options: interpret_markers(read(path), options), MARKER_OPTIONS)


MARKERS: tuple[Reader[MarkerTake], ...] = (
    _row("C3D", (".c3d",), read_c3d),
    _row("TRC", (".trc",), read_trc),
    _row("TRC", (".csv", ".txt", ".tsv"), read_trc, lambda head: head.lower().startswith(FILE_TYPE)),
    _row("OptiTrack Motive CSV", (".csv",), read_motive_csv, begins_as_motive),
    _row("Vicon Nexus CSV", (".csv", ".txt"), read_nexus_csv, lambda head: bool(sections_of(head.splitlines()))),
    _interpreted("array of 3D points (.npy)", is_point_array, read_point_array),
    _row("Qualisys TSV", (".tsv", ".txt", ".csv"), read_qualisys_tsv, lambda head: head.upper().startswith(FIRST_LINE)),
    _row("Qualisys MATLAB file", (".mat",), read_qualisys_mat),
    _row("table of points", (".csv", ".tsv", ".txt"), read_point_table, begins_as_points),
    _row("live recording that was not finished", (SUFFIX,), read_live_recording),
)
"""Readers, tried in this order. The first one that recognises a path reads it."""


def read_markers(path: Path | str, **options: Any) -> MarkerTake:
    """Read a marker file with the first reader that recognises it.

    The options are ``fps``, ``unit`` and ``up_axis`` from ``ReadOptions``.

    Raises:
        FileMissing, CaptureNotRecognised: the file does not exist, or no reader recognises it.
        JobInvalid: the frame rate, unit or axis is invalid, or an option is unknown.
        MocapError: errors that the reader raises.
    """
    path, chosen = require_file(path), ReadOptions(**options)
    reader = next((reader for reader in MARKERS if reader.recognises(path)), None)
    if reader is None:
        kinds = "; ".join(reader.kind for reader in MARKERS)
        what = "The file is not a readable marker recording."
        raise CaptureNotRecognised(what, where=str(path), hint=f"Supported files: {kinds}.")
    return reader.open(path, chosen)


WRITERS: dict[str, Callable[..., Path]] = {"c3d": write_c3d, "trc": write_trc}  # By file suffix.


def write_markers(path: Path, cloud: MarkerCloud, *, overwrite: bool = False) -> Path:
    """Write markers (metres, Z up) to a file. The suffix determines the format (``WRITERS``)."""
    return WRITERS[path.suffix.lower().lstrip(".")](path, cloud, overwrite=overwrite)
