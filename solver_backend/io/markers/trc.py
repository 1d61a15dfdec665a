"""Markers from and to TRC files (track row column) of OpenSim, Cortex, Mokka, MotionBuilder and others.

Source: the OpenSim user's guide, "Marker (.trc) files". Cells between tabs: file type, names of the header's values,
these values, 'Frame#', 'Time' and the labels, each above the first of its three columns (some programs write more or
fewer tabs), X1 Y1 Z1 ..., mostly an empty line, then the frames. An unseen marker is blank, NaN or 0. Counts in the
header are often wrong, so the rows decide.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from solver_backend.exchange.errors import FileDamaged, NonFiniteData
from solver_backend.exchange.outputs import write_text
from solver_backend.io.files import read_text
from solver_backend.io.markers.c3d import unnamed_labels
from solver_backend.io.markers.source import MarkerSource
from solver_backend.io.recognition.marker_unit import metres_in
from solver_backend.io.recognition.marker_up_axis import rotation_to_z_up
from solver_backend.io.text_table import (
    ROWS_LOOKED_AT,
    between_tabs,
    different_count,
    frame_facts,
    is_number,
    number_in,
    read_numbers,
    triples,
)
from solver_backend.types import MarkerCloud

FILE_TYPE = "pathfiletype"  # Beginning of the files in small letters.
_HEADER_LINES = 20  # Lines within which the labels must come.


def read_trc(path: Path) -> MarkerSource:
    """Read the markers of a TRC file. Raise FileMissing or FileDamaged."""
    lines = read_text(path).splitlines()
    heading = next((line for line in lines[:_HEADER_LINES] if line.strip(' "').lower().startswith("frame#")), "")
    lines = between_tabs(lines, heading)
    at = _line_of("frame#", lines[:_HEADER_LINES])
    if at is None:
        what = "The file is truncated or is not TRC: a line that begins with 'Frame#' is expected."
        raise FileDamaged(what, where=str(path), hint="Export it again.")
    names, header = _line_of("datarate", lines[:at]), {}
    if names is not None and names + 1 < at:
        pairs = zip(_cells(lines[names]), _cells(lines[names + 1]), strict=False)
        header = {name.lower(): value for name, value in pairs}
    labels = _labels(lines[at])
    first = next((i for i in range(at + 1, len(lines)) if is_number(_cells(lines[i])[0])), len(lines))
    rows = [line.split("\t") if "\t" in line else line.split() for line in lines[first:] if line.strip()]
    rows, stated = _without_doubled_tabs(rows, len(labels)), number_in(header.get("nummarkers"))
    # Other numbers may be of points without labels, or of a header that decimal commas shifted.
    width = 2 + 3 * len(labels) if labels else 0
    values = read_numbers(rows, first + 1, path, width=width, sure=stated == len(labels))
    count = max(len(labels), -(-max(values.shape[1] - 2, 0) // 3))
    rate, length = number_in(header.get("datarate")), number_in(header.get("numframes"))
    frames = frame_facts(values[:, :1].ravel(), values[:, 1:2].ravel(), rate, length)
    return MarkerSource(
        path=path,
        format="TRC",
        positions=triples(values, range(2, 2 + 3 * count, 3)),
        labels=(*labels, *[""] * (count - len(labels))),
        rate=frames.rate,
        default_unit="mm",
        default_up_axis="y",
        unit=header.get("units", ""),
        first_frame=frames.first,
        problems=(*different_count("markers", stated, count), *frames.problems),
    )


def _line_of(start: str, lines: list[str]) -> int | None:
    return next((i for i, line in enumerate(lines) if line.strip().lower().startswith(start)), None)


def _labels(line: str) -> list[str]:
    cells = _cells(line)[2:]
    named = [i for i, cell in enumerate(cells) if cell]
    if named and all(i % 3 == 0 for i in named):
        return cells[: named[-1] + 1 : 3]
    return [cells[i] for i in named]


def _cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.split("\t")] if "\t" in line else line.split() or [""]


def _without_doubled_tabs(rows: list[list[str]], markers: int) -> list[list[str]]:
    sample = rows[:ROWS_LOOKED_AT]
    too_long = markers and any(len(row) > 3 + 3 * markers for row in sample)
    if too_long and not any(cell.strip() for row in sample for cell in row[1::2]):
        return [row[::2] for row in rows]
    return rows


def write_trc(
    path: Path | str, cloud: MarkerCloud, *, unit: str = "mm", up_axis: str = "y", overwrite: bool = False
) -> Path:
    """Write markers (Z up, metres) to a TRC file in a unit of ``METRES`` and with an axis up, missing ones as NaN.

    Raises:
        OutputExists, OutputNotWritable: see ``atomic_output``.
        NonFiniteData: the frame rate is not positive.
        JobInvalid: the unit or the axis is unknown.
    """
    if not (np.isfinite(cloud.fps) and cloud.fps > 0):
        raise NonFiniteData(f"The frame rate must be a positive number, not {cloud.fps}.", where=str(path))
    positions = np.asarray(cloud.positions, dtype=np.float64)
    frames, markers = positions.shape[:2]
    labels = cloud.labels or unnamed_labels(markers)
    values = (positions.reshape(-1, 3) @ rotation_to_z_up(up_axis) / metres_in(unit)).reshape(frames, 3 * markers)
    times = np.arange(frames) / cloud.fps
    rate = f"{cloud.fps:.10g}"  # 100, not 100.000000, but 119.88012 in full
    head = [
        f"PathFileType\t4\t(X/Y/Z)\t{Path(path).name}",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"{rate}\t{rate}\t{frames}\t{markers}\t{unit}\t{rate}\t1\t{frames}",
        "Frame#\tTime\t" + "\t\t\t".join(label.replace("\t", " ") for label in labels) + "\t\t",
        "\t\t" + "\t".join(f"{axis}{i}" for i in range(1, markers + 1) for axis in "XYZ"),
        "",
    ]
    rows = [
        f"{i}\t{time:.6f}\t" + "\t".join(f"{value:.6f}" if value == value else "NaN" for value in row)
        for i, (time, row) in enumerate(zip(times.tolist(), values.tolist(), strict=True), 1)
    ]
    return write_text(path, "\n".join(head + rows) + "\n", overwrite=overwrite)
