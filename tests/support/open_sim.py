"""Joint angles: of an OpenSim motion file (``.mot``), and of the points that a hinge stands between."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

LENGTHS = re.compile(r"time|.*_t[xyz]")  # Columns that are no angles.


def read_mot(path: Path) -> dict[str, np.ndarray]:
    """Return the columns of a motion file by name, angles in degrees.

    Raises:
        ValueError: the header does not end or does not say what angles are in, or rows are ragged.
    """
    header, _, body = path.read_text(encoding="utf-8").partition("endheader")
    units = re.search(r"inDegrees=(yes|no)", header.replace(" ", ""))
    if units is None:
        raise ValueError(f"{path.name}: the header does not say whether angles are in degrees.")
    names, *rows = [line.split() for line in body.strip().splitlines()]
    if not rows or any(len(row) != len(names) for row in rows):
        raise ValueError(f"{path.name}: the rows do not fit the {len(names)} columns.")
    columns = dict(zip(names, np.array(rows, dtype=np.float64).T, strict=True))
    if units[1] == "no":
        columns |= {name: np.degrees(values) for name, values in columns.items() if not LENGTHS.fullmatch(name)}
    return columns


def flexion_deg(above: np.ndarray, hinge: np.ndarray, below: np.ndarray) -> np.ndarray:
    """Return (F,) degrees by which a hinge of (F, 3) points is bent, 0 when straight."""
    u, v = hinge - above, below - hinge
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(u, v), axis=-1), (u * v).sum(-1)))
