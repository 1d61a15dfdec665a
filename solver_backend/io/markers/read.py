"""Every kind of file of markers that is read, and reading one whichever it is."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from solver_backend.exchange.errors import CaptureNotRecognised
from solver_backend.exchange.outputs import open_regular, require_file
from solver_backend.io.files import as_text
from solver_backend.io.interpretation import MARKER_OPTIONS, interpret_markers
from solver_backend.io.markers.c3d import read_c3d
from solver_backend.io.markers.c3d_writer import write_c3d
from solver_backend.io.markers.camera_systems import (
    FIRST_LINE,
    begins_as_motive,
    read_motive_csv,
    read_nexus_csv,
    read_qualisys_mat,
    read_qualisys_tsv,
    sections_of,
)
from solver_backend.io.markers.live_recording import SUFFIX, read_live_recording
from solver_backend.io.markers.point_table import begins_as_points, is_point_array, read_point_array, read_point_table
from solver_backend.io.markers.source import MarkerSource, MarkerTake
from solver_backend.io.markers.trc import FILE_TYPE, read_trc, write_trc
from solver_backend.io.reader import Reader, ReadOptions
from solver_backend.types import MarkerCloud

ReadFile = Callable[[Path], MarkerSource]
"""Returns what a file says; raises our own errors."""
_HEAD_BYTES = 65536
"""A file's format is recognised from so much of it."""


def _row(
    kind: str, suffixes: tuple[str, ...], read: ReadFile, begins: Callable[[str], bool] | None = None
) -> Reader[MarkerTake]:

    def recognises(path: Path) -> bool:
        return path.suffix.lower() in suffixes and path.is_file() and (begins is None or begins(_head(path)))

    return _interpreted(f"{kind} ({', '.join(suffixes)})", recognises, read)


def _interpreted(kind: str, recognises: Callable[[Path], bool], read: ReadFile) -> Reader[MarkerTake]:
    return Reader(kind, recognises, lambda path, options: interpret_markers(read(path), options), MARKER_OPTIONS)


def _head(path: Path) -> str:
    try:
        with open_regular(path) as stream:
            return as_text(stream.read(_HEAD_BYTES)).lstrip(' "\r\n\t')
    except OSError:
        return ""


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
"""Asked in this order; the first that recognises a path reads it."""


def read_markers(path: Path | str, *, readers: Sequence[Reader[MarkerTake]] = MARKERS, **options: Any) -> MarkerTake:
    """Read a file of markers.

    Args:
        readers: asked in this order.
        options: fps, unit and up_axis of ``ReadOptions``.

    Raises:
        FileMissing: there is no such file.
        CaptureNotRecognised: no reader knows the path.
        JobInvalid: the frame rate, unit or axis is impossible, or another option is given.
        MocapError: whatever else the reader raises.
    """
    path, chosen = require_file(path), ReadOptions(**options)
    reader = next((reader for reader in readers if reader.recognises(path)), None)
    if reader is None:
        kinds = "; ".join(reader.kind for reader in readers)
        what = "The file is not a recording of markers that can be read."
        raise CaptureNotRecognised(what, where=str(path), hint=f"Readable are {kinds}.")
    return reader.open(path, chosen)


WRITERS: dict[str, Callable[..., Path]] = {"c3d": write_c3d, "trc": write_trc}
"""By the ending of the files."""


def write_markers(path: Path, cloud: MarkerCloud, *, overwrite: bool = False) -> Path:
    """Write markers in the format that the path's ending names.

    Args:
        path: ends in one of ``WRITERS``.
        cloud: markers, Z up, in metres.

    Raises:
        OutputExists, OutputNotWritable: see ``atomic_output``.
        NonFiniteData, ShapeMismatch: the format cannot hold them, see its writer.
    """
    return WRITERS[path.suffix.lower().lstrip(".")](path, cloud, overwrite=overwrite)
