"""Readers of optical markers."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from solver_backend.io.interpretation import interpret_markers
from solver_backend.io.load import load_capture
from solver_backend.io.markers.c3d import read_c3d
from solver_backend.io.markers.camera_systems import read_motive_csv, read_nexus_csv, read_qualisys_tsv, read_trc
from solver_backend.io.markers.live_recording import LiveBlock, pack_block
from solver_backend.io.markers.read import read_markers
from solver_backend.io.reader import ReadOptions
from tests.fuzz import odd_markers
from tests.fuzz.odd_markers import text as _text
from tests.fuzz.target import Target, Write, file, is_folder
from tests.support.c3d_bytes import DEC, INTEL, MIPS, C3dBytes
from tests.support.c3d_takes import LABELS, standing
from tests.support.marker_texts import NEXUS_SECTIONS, TEXTS

_SUBJECTS = ("Ann:LFHD", "Ann:LTOE", "*2", "")


def _c3d(processor: int, floating: bool) -> Write:
    points = np.random.default_rng(5).uniform(-1000, 1000, (4, 4, 3)).round(1)
    whole = C3dBytes(points, _SUBJECTS, processor, floating, channels=("F",), samples=2, header_events=[("on", 0.01)])
    whole.more = {
        "TRIAL": {"ACTUAL_START_FIELD": whole.ints(1, 0), "ACTUAL_END_FIELD": whole.ints(4, 0)},
        "EVENT": {"USED": whole.ints(1), "LABELS": whole.text(["Foot"]), "TIMES": (4, (2, 1), whole.real(0, 1))},
    }
    return file("a.c3d", whole.to_bytes())


def _c3d_of_two() -> Write:
    labels = ("A:LFHD", "A:C7", "B:LANK", "B:LTOE")
    residual = np.full((12, 4), 5.0)
    return file("a.c3d", C3dBytes(standing(), labels, fourth=residual, screen=None, units=None).to_bytes())


def _live(known: bool) -> bytes:
    """Return a live recording, with or without what turns its points into metres."""
    points = np.random.default_rng(6).uniform(0.1, 1.7, (4, 9, 3))
    return b"".join(
        pack_block(LiveBlock(k / 60.0, p, 60.0, np.eye(3) if known else None)) for k, p in enumerate(points)
    )


def _read(folder: Path) -> object:
    return read_markers(next(folder.iterdir()))


def _told(folder: Path) -> object:
    path = next(folder.iterdir())
    return read_markers(path, **odd_markers.TOLD.get(path.stem, {}))


_BY_FORMAT = {
    "c3d": read_c3d, "trc": read_trc, "motive": read_motive_csv, "nexus": read_nexus_csv, "qtm": read_qualisys_tsv,
}  # fmt: skip
"""The reader of each format by the name of the file."""


def _by_format(folder: Path) -> object:
    path = next(folder.iterdir())
    told = ReadOptions(fps=-1.0 if path.suffix == ".dat" else None)
    return interpret_markers(_BY_FORMAT[path.stem](path), told)


TARGETS: tuple[Target, ...] = (
    Target(
        "markers, C3D",
        (
            file("a.c3d", C3dBytes(standing(), LABELS).to_bytes()),
            *(_c3d(processor, floating) for processor in (INTEL, DEC, MIPS) for floating in (True, False)),
        ),
        _read,
        {".c3d": "binary"},
        (*odd_markers.C3D, *odd_markers.LYING),
    ),
    Target(
        "markers, live recording",
        (file("a.c3d.recording", _live(True)), file("a.c3d.recording", _live(False))),
        _read,
        {".recording": "binary"},
        (file("a.c3d.recording", _live(True)[:-9] + _live(False)), file("a.c3d.recording", b"")),
    ),
    Target(
        "markers, TRC",
        (_text("t.trc"), _text("t.trc", ("\t", "  ")), _text("t.trc", ("C7\t\t\tLTOE", "C7\tLTOE"))),
        _read,
        {".trc": "table"},
        odd_markers.TRC,
        (is_folder("t.trc"), file("t.xyz", "none of ours"), file("t.csv", "none")),
    ),
    Target(
        "markers, Motive CSV",
        (_text("motive.csv"), _text("motive.csv", ("Meters", "Millimeters"), ("Rigid Body", "Bone Marker"))),
        _read,
        {".csv": "table"},
        odd_markers.MOTIVE,
    ),
    Target(
        "markers, Nexus CSV",
        (_text("nexus.csv"), _text("nexus.csv", (",", ";")), file("a.csv", NEXUS_SECTIONS + TEXTS["nexus.csv"])),
        _read,
        {".csv": "table", ".txt": "table"},
        odd_markers.NEXUS,
    ),
    Target(
        "markers, Qualisys TSV",
        (_text("qtm.tsv"),),
        _read,
        {".tsv": "table", ".txt": "table"},
        odd_markers.QUALISYS,
    ),
    Target(
        "markers, table of points",
        (
            _text("points.csv"),
            _text("points.csv", ("_x", " X"), ("_y", " Y"), ("_z", " Z"), (",", ";")),
            file("a.csv", "time,marker,x,y,z\n" + "".join(f"{f},{m},{f},2,3\n" for f in range(4) for m in "ABCDE")),
        ),
        _read,
        {".csv": "table", ".txt": "table"},
        (file("a.csv", "frame,marker,x,y,z\n"), file("a.csv", "frame,marker,x,y,z\n1e300,A,1,2,3\nnan,A,1,2,3\n")),
    ),
    Target(
        "markers, by their format",
        (_text("motive.csv"), _text("nexus.csv"), _text("qtm.tsv")),
        _by_format,
        {".csv": "table", ".tsv": "table", ".c3d": "binary"},
        (file("motive.csv", ""), file("nexus.csv", "none"), file("qtm.tsv", ""), file("c3d.c3d", "")),
        (is_folder("nexus.csv"), file("trc.dat", TEXTS["t.trc"])),
    ),
    Target(
        "markers, by what is told",
        tuple(file(f"{name}.trc", TEXTS["t.trc"]) for name in ("all", "other")),
        _told,
        {".trc": "table"},
        tuple(file(f"{name}.trc", TEXTS["t.trc"]) for name in odd_markers.TOLD),
    ),
    Target(
        "markers, told",
        (_text("t.trc"), _text("nexus.csv"), _text("qtm.tsv"), file("a.c3d", C3dBytes(standing(), LABELS).to_bytes())),
        lambda folder: read_markers(next(folder.iterdir()), fps=50.0, unit="cm", up_axis="-z"),
        {".trc": "text", ".csv": "text", ".tsv": "text", ".c3d": "binary"},
    ),
    Target(
        "capture of markers",
        (_text("t.trc"), _text("nexus.csv"), file("a.c3d", C3dBytes(standing(), LABELS).to_bytes())),
        lambda folder: load_capture(next(folder.iterdir())),
        {".trc": "text", ".csv": "text", ".c3d": "binary", ".txt": "text", ".dat": "text"},
        (
            _text("nexus.csv", ("A:LTOE", "B:LTOE")),
            _text("t.trc", ("LTOE", "C7")),
            _text("nexus.csv", ("LTOE", "C7")),
            file("a.txt", "no markers at all\n"),
            file("a.dat", "none"),
        ),
    ),
    Target(
        "capture of one subject",
        (_text("nexus.csv"), _text("nexus.csv", ("A:LTOE", "B:LTOE")), _c3d_of_two()),
        lambda folder: load_capture(next(folder.iterdir()), subject_prefix="A"),
        {".csv": "text", ".c3d": "binary"},
    ),
)
