"""Joint angles of an OpenSim motion file (``.mot``)."""

from __future__ import annotations

from pathlib import Path

import numpy as np


def read_mot(path: Path) -> dict[str, np.ndarray]:
    """Return the columns of a motion file by name.

    Raises:
        ValueError: the header does not end, angles are not in degrees, or rows are ragged.
    """
    header, _, body = path.read_text(encoding="utf-8").partition("endheader")
    if "inDegrees=yes" not in header.replace(" ", ""):
        raise ValueError(f"{path.name}: angles in degrees are expected.")
    names, *rows = [line.split() for line in body.strip().splitlines()]
    if not rows or any(len(row) != len(names) for row in rows):
        raise ValueError(f"{path.name}: the rows do not fit the {len(names)} columns.")
    return dict(zip(names, np.array(rows, dtype=np.float64).T, strict=True))
