"""Read a file of markers, whichever of the known formats it has."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from solver_backend.exchange.errors import CaptureNotRecognised, FileDamaged
from solver_backend.io.files import require_file
from solver_backend.io.markers.c3d import read_c3d
from solver_backend.io.markers.c3d_parameters import KEY
from solver_backend.io.markers.motive_csv import read_motive_csv
from solver_backend.io.markers.nexus_csv import read_nexus_csv, sections_of
from solver_backend.io.markers.qualisys_tsv import FIRST_LINE, read_qualisys_tsv
from solver_backend.io.markers.take import MarkerTake
from solver_backend.io.markers.trc import read_trc

_HEAD_BYTES = 65536
"""So much of a file tells its format."""


@dataclass(frozen=True)
class MarkerFormat:
    """A format: how its files look, and what reads them."""

    name: str
    """For messages."""
    suffixes: tuple[str, ...]
    """Endings of its files' names."""
    begins: Callable[[bytes, str], bool]
    """Whether a file that begins with these bytes, and this text, has the format."""
    read: Callable[..., MarkerTake]
    """Its reader."""


FORMATS = (
    MarkerFormat("C3D", (".c3d",), lambda head, text: head[1:2] == bytes([KEY]), read_c3d),
    MarkerFormat("TRC", (".trc",), lambda head, text: text.lower().startswith("pathfiletype"), read_trc),
    MarkerFormat(
        "OptiTrack Motive CSV",
        (".csv",),
        lambda head, text: text.lstrip('"').lower().startswith("format version"),
        read_motive_csv,
    ),
    MarkerFormat(
        "Vicon Nexus CSV", (".csv", ".txt"), lambda head, text: bool(sections_of(text.splitlines())), read_nexus_csv
    ),
    MarkerFormat(
        "Qualisys TSV",
        (".tsv", ".txt"),
        lambda head, text: text.lstrip().upper().startswith(FIRST_LINE),
        read_qualisys_tsv,
    ),
)
"""Every format of markers that is read."""


def format_of(path: Path | str) -> MarkerFormat | None:
    """Return the format of a file of markers by its ending and its beginning, None where it has none of them.

    A file whose ending is of one format alone is taken to have that format, damaged or not.

    Raises:
        FileMissing: there is no such file.
        FileDamaged: the file cannot be read.
    """
    path = require_file(path)
    candidates = [known for known in FORMATS if path.suffix.lower() in known.suffixes]
    if len(candidates) == 1:
        return candidates[0]
    try:
        with open(path, "rb") as stream:
            head = stream.read(_HEAD_BYTES)
    except OSError as error:
        raise FileDamaged(f"The file cannot be read: {error.strerror or error}.", where=str(path)) from error
    text = head.decode("utf-8-sig", "replace")
    return next((known for known in candidates if known.begins(head, text)), None)


def read_markers(
    path: Path | str, *, fps: float | None = None, unit: str | None = None, up_axis: str | None = None
) -> MarkerTake:
    """Read a file of markers.

    Args:
        path: the file.
        fps: frames per second; None takes what the file says.
        unit: its length unit; None takes what the file says, or estimates it from the markers' spread.
        up_axis: its axis that points up; None takes what the file says, or how the body stands.

    Raises:
        CaptureNotRecognised: it has none of the known formats.
        FileMissing, FileDamaged, NoDetections, JobInvalid: see the readers.
    """
    found = format_of(path)
    if found is None:
        names = ", ".join(f"{known.name} ({'/'.join(known.suffixes)})" for known in FORMATS)
        raise CaptureNotRecognised(
            "The file is no recording of markers that can be read.", where=str(path), hint=f"Readable are {names}."
        )
    return found.read(path, fps=fps, unit=unit, up_axis=up_axis)
