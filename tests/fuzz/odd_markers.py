"""Files of optical markers that are odd or cannot be: each is read with a problem or refused by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tests.fuzz.target import Write, file
from tests.support.c3d_bytes import C3dBytes, Value
from tests.support.c3d_takes import LABELS, standing
from tests.support.marker_texts import NEXUS_SECTIONS, TEXTS

_PLAIN = C3dBytes(standing(), LABELS)
_BLOCK = 512


def text(name: str, *changes: tuple[str, str]) -> Write:
    """Return what writes one of the small tables, with some of its words changed."""
    content = TEXTS[name]
    for old, new in changes:
        content = content.replace(old, new)
    return file(name, content)


def _c3d(change: Callable[[bytes], bytes] = bytes, **options: object) -> Write:
    """Return what writes a C3D whose fields are others, and whose bytes are changed then."""
    return file("a.c3d", change(replace(_PLAIN, **options).to_bytes()))  # type: ignore[arg-type]


def _with(group: str, name: str, value: Value) -> Write:
    return _c3d(more={group: {name: value}})


def _at(place: int, piece: bytes) -> Callable[[bytes], bytes]:
    return lambda data: data[:place] + piece + data[place + len(piece) :]


def _end_of_section(data: bytes) -> bytes:
    """Return a file whose last record has a name and no room for its parameter."""
    section = bytes([1, 0x50, 1, 84]) + bytes([1, 255]) + b"P" + (499).to_bytes(2, "little")
    section = section.ljust(4 + 502, b"\0") + bytes([1, 1]) + b"X" + bytes(2)
    return data[:_BLOCK] + section.ljust(_BLOCK, b"\0") + data[_BLOCK:]


_FRAME = 16 * len(LABELS)  # Bytes of a frame.
_CHANNELS = tuple(f"F{i}" for i in range(10))
_FAR = np.full((2, 300, 3), 500.0)
C3D: tuple[Write, ...] = (
    _c3d(_at(4, bytes([10, 0])), channels=_CHANNELS, samples=5),
    _c3d(points=standing()[:, :0], labels=()),
    _c3d(last=65535),
    _c3d(lambda data: data[: -len(standing()) * _FRAME]),
    _c3d(lambda data: data[: -5 * _FRAME]),
    _c3d(scale=0.0),
    _c3d(fourth=np.full((len(standing()), len(LABELS)), -1.0)),
    _c3d(points=_FAR, labels=tuple(f"M{i}" for i in range(300))),
    _c3d(screen=("+X", "-Y")),
    _c3d(units="furlong"),
    _c3d(units="m"),
    _c3d(rate=0.0),
    _c3d(labels=("ANGLES", *LABELS[1:])),
    _with("POINT", "ANGLES", (-1, (len(LABELS[0]), 1), LABELS[0].encode())),
    _with("POINT", "LONG_FRAMES", (1, (1,), bytes([len(standing())]))),
    _with("POINT", "LONG_FRAMES", (-1, (1,), b"x")),
    _with("POINT", "UNITS", _PLAIN.ints(1)),
    _with("TRIAL", "ACTUAL_START_FIELD", _PLAIN.ints(65535, 65535)),
    file("a.c3d", b""),
    file("a.c3d", b"\x02\x51" * 300),
    _c3d(_at(0, b"\xc8")),
    _c3d(_at(_BLOCK + 3, b"\x01")),
    _c3d(_end_of_section),
)
_TYPES = ",,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Marker,Marker,Marker\n"
TRC: tuple[Write, ...] = (
    text("t.trc", ("1.5\t2\t3\t4\t5\t6", "1.5\t\t2\t\t3\t\t4\t\t5\t\t6"), ("1\t0.00", "1\t\t0.00")),
    text("t.trc", ("100\t100\t3", "250\t250\t3")),
    text("t.trc", ("100\t100\t3", "0\t0\t3")),
    text("t.trc", ("mm", "m"), ("\t4\t5\t6", "\t4000\t5000\t6000"), ("\t4\t5\tNaN", "\t0\t0\t0")),
    text("t.trc", ("PathFileType", "PathFileType" + "x" * 140_000)),
    text("t.trc", ("LTOE", "C7")),
    text("t.trc", ("C7\t\t\tLTOE", "LTOE\t\t\tC7")),
    text("t.trc", ("Frame#", "Nothing")),
    text("t.trc", ("1.5\t2\t3", "0\t0\t0")),
    file("t.trc", TEXTS["t.trc"] + "9\t0.1\t1\n" * 1000 + "9\t0.1" + "\t1" * 2000 + "\n"),
    file("t.trc", ""),
)
MOTIVE: tuple[Write, ...] = (
    file("motive.csv", "\n" + TEXTS["motive.csv"]),
    text("motive.csv", ("0,0.000000,1", "0,0.000000,01:02:03:04")),
    text("motive.csv", (_TYPES, "")),
    text("motive.csv", ("Marker", "Rigid Body Marker")),
    text("motive.csv", (",Marker,Marker,Marker", ",Bone,Bone,Bone")),
    text("motive.csv", ("Rigid Body,Rigid", "Bone Marker,Rigid")),
    text("motive.csv", ("Frame,Time", "Image,Time")),
    file("motive.csv", TEXTS["motive.csv"].replace('"A, b"', '"' + "b" * 140_000)),
)
NEXUS: tuple[Write, ...] = (
    file("nexus.csv", NEXUS_SECTIONS),
    text("nexus.csv", ("A:LTOE", "A:LHipAngles")),
    text("nexus.csv", ("100,-20,1500", "0,0,0")),
    text("nexus.csv", ("Frame,Sub Frame,X", "Image,Part,X")),
    text("nexus.csv", ("mm,mm,mm,mm,mm,mm", "m,m,m,m,m,m")),
    file("nexus.txt", TEXTS["nexus.csv"]),
)
QUALISYS: tuple[Write, ...] = (
    text("qtm.tsv", ("\t3D", "\t2D")),
    text("qtm.tsv", ("DATA_INCLUDED\t3D\n", ""), ("MARKER_NAMES\tC7\tLTOE\n", "")),
    file("qtm.tsv", "NO_OF_FRAMES\t2\nFREQUENCY\t100\nMARKER_NAMES\tC7\n1\n2\n"),
    file("qtm.tsv", "NO_OF_FRAMES\t2\nFREQUENCY\t100\nMARKER_NAMES\tC7\n1\t2\t3\n4\t5\t6\n"),
    text("qtm.tsv", ("200", "nothing"), ("0.010", "0.005")),
    file("qtm.txt", TEXTS["qtm.tsv"]),
)


def as_lying(feet_m: float) -> Write:
    """Return what writes a body that stands along another axis than its file states, so far above the floor."""
    points = standing()[..., [2, 0, 1]].copy()
    points[..., 0] += 1000.0 * feet_m - points[..., 0].min()
    return _c3d(points=points)


LYING: tuple[Write, ...] = (
    as_lying(0.0),
    as_lying(2.0),
    _c3d(points=standing()[..., [2, 0, 1]], screen=None),
    _c3d(points=standing() * 50, units="cm"),
)
TOLD: dict[str, dict[str, object]] = {
    "unit": {"unit": "furlong"}, "axis": {"up_axis": "w"}, "rate": {"fps": -1.0}, "all": {"fps": 50.0, "unit": "cm"},
}  # fmt: skip
"""Options by the name of the file that is read with them."""
