"""Files of markers that are recognised but not supported, and how to convert them."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

_FORMATS = (
    ((".trb",), "binary tracks of Motion Analysis EVaRT or Cortex", "Export TRC or C3D from Cortex."),
    ((".cap",), "a project of Motion Analysis Cortex", "Export TRC or C3D from Cortex."),
    ((".tdf",), "a recording of BTS SMART", "Export C3D from SMART Tracker or SMART Analyzer."),
    (
        (".rah", ".raw", ".ric", ".rif", ".ang", ".mom", ".pwr", ".gr1", ".gr2", ".emf", ".emg", ".emr"),
        "a file of BTS ELITE", "Export C3D from the program that recorded it.",
    ),
    ((".x1d", ".x2d", ".xcp", ".vsk", ".mp", ".trial"), "a part of a Vicon trial", "Choose the trial's .c3d."),
    ((".tak",), "a take of OptiTrack Motive", "Export C3D or CSV from Motive."),
    ((".qtm", ".qca"), "a recording of Qualisys Track Manager", "Export C3D or TSV from QTM."),
    ((".mvn", ".mvnx"), "a recording of Xsens MVN", "Export C3D, or BVH for `motion`, from MVN."),
    ((".fbx", ".bvh", ".glb", ".asf", ".amc"), "a motion of a skeleton", "BVH is read by the verb `motion`."),
    ((".mot", ".sto", ".osim"), "a file of OpenSim without markers", "Choose the TRC or C3D that it was made from."),
    ((".xmove", ".xml"), "an XML file", "Export C3D or TRC from the program that wrote it."),
    ((".xlsx", ".xls", ".ods"), "a spreadsheet", "Save the sheet as CSV or text; TRC and CSV of tracks are read."),
)  # fmt: skip
"""Ends of files' names, what they are, and the way out."""
_LINES, _LEAST_COLUMNS = 5, 8
"""Lines that are looked at, and numbers in each: two counts and two markers."""


def name_unsupported_file(path: Path) -> tuple[str, str] | None:
    """Return what a file is that is not supported, and how to convert it; None where that is not known."""
    if _is_table_without_header(path):
        what = "a table of numbers that names neither markers nor frame rate"
        return (
            f"not supported: {what}.",
            "Export it again with its header (Nexus: labels and units), or as C3D.",
        )
    suffix = path.suffix.lower()
    found = next(((what, how) for suffixes, what, how in _FORMATS if suffix in suffixes), None)
    return None if found is None else (f"not supported: {found[0]}.", found[1])


def _is_table_without_header(path: Path) -> bool:
    """Return whether a text file's first lines are numbers alone, of as many columns each."""
    if path.suffix.lower() not in (".csv", ".txt", ".tsv"):
        return False
    with path.open(encoding="utf-8", errors="replace") as file:
        lines = [line.rstrip("\r\n") for line in islice(file, _LINES) if line.strip()]
    rows = [line.split("\t" if "\t" in line else ";" if ";" in line else ",") for line in lines]
    widths = {len(row) for row in rows}
    return len(widths) == 1 and min(widths) >= _LEAST_COLUMNS and all(_is_number(cell) for row in rows for cell in row)


def _is_number(cell: str) -> bool:
    try:
        float(cell.replace(",", ".") or "nan")
    except ValueError:
        return False
    return True
