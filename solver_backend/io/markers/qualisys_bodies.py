"""Rigid bodies of Qualisys Track Manager: the TSV file of 6D data beside that of the markers.

Source: the QTM user manual, "TSV file formats, 6DOF data", and "Rotation angles in QTM". After the header
(NO_OF_BODIES, FREQUENCY, BODY_NAMES, a row of column names) come, of every body, X, Y, Z in millimetres, Roll, Pitch,
Yaw in degrees (about the x, the new y and the newest z axis: ``R = Rx Ry Rz``), the residual, and Rot[0] to Rot[8]. A
body that is not seen is blank or all zeros.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from solver_backend.exchange.so3 import matrix_from_rotvec
from solver_backend.io.markers.rigid_bodies import RigidBodies
from solver_backend.io.markers.text_table import number_in

WORDS = 16
"""Numbers of a body in a frame."""
ENDING = "_6D"
"""What QTM adds to the name of the file of 6D data."""
_AGREE = 1e-3
"""Elements of two rotations differ by so little where they are one."""


def bodies_file(path: Path) -> Path | None:
    """Return the file of 6D data that belongs to a file of markers, ``walk_6D.tsv`` of ``walk.tsv``; None without."""
    beside = path.with_name(f"{path.stem.removesuffix('_3D')}{ENDING}.tsv")
    return beside if beside != path and beside.is_file() else None


def qualisys_bodies(header: Mapping[str, Sequence[str]], values: np.ndarray, frames: int) -> RigidBodies | None:
    """Return the bodies of a table of 6D data; None where it is no such table, or of other frames.

    Args:
        header: cells by the name at the line's beginning, in capitals.
        values: (F, C) numbers, NaN where blank.
        frames: of the markers.
    """
    names = [name for name in header.get("BODY_NAMES", []) if name]
    count = len(names) or int(number_in(" ".join(header.get("NO_OF_BODIES", []))) or 0)
    before = values.shape[1] - WORDS * count
    if not count or before not in (0, 2) or len(values) != frames:
        return None
    words = values[:, before:].reshape(frames, count, WORDS)
    names = [*names, *(f"Body {n + 1}" for n in range(len(names), count))]
    seen = np.isfinite(words[..., :3]).all(-1) & (words[..., 7:] != 0).any(-1)
    return RigidBodies(tuple(names), np.where(seen[..., None], words[..., :3], np.nan), _rotations(words, seen))


def _rotations(words: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Return the (F, B, 3, 3) rotations: Rot[0] to Rot[8] by columns, or by rows where the angles agree with that."""
    columns = np.nan_to_num(words[..., 7:]).reshape(*words.shape[:2], 3, 3)
    x, y, z = (matrix_from_rotvec(angle[..., None] * axis) for angle, axis in zip(
        np.moveaxis(np.radians(np.nan_to_num(words[..., 3:6])), -1, 0), np.eye(3), strict=True,
    ))  # fmt: skip
    by_angles = x @ y @ z
    by_rows = bool(seen.any()) and np.abs(columns - by_angles)[seen].max() < _AGREE
    return columns if by_rows else np.swapaxes(columns, -1, -2)
