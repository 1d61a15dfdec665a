"""Cameras of a file as they are meant, where as written no camera can be so: shares of the picture, mirrored worlds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.exchange.errors import CalibrationInvalid
from solver_backend.geometry.rotations import exp_so3
from solver_backend.io.calibration.entry import ROUNDING, CameraEntry

LARGEST_SHARE = 10.0
"""Focal length up to which it is in widths of the picture: the longest lenses have 8, the shortest in pixels 100."""
SHORTEST_SHARE = 0.05
"""Focal length in widths of the picture below which it is in other units than pixels: it would show 168 degrees."""
OFF_MIDDLE = 0.15
"""How far principal points are from the middle at most, in the picture's size: from corners they are 0.3 or more."""
SURELY_DEGREES = 4.0 * np.pi
"""Length of a rotation vector that none in radians has: two turns."""
_MIRROR = np.diag([-1.0, 1.0, 1.0])


def meant_entries(entries: Sequence[CameraEntry]) -> tuple[list[CameraEntry], tuple[Diagnostic, ...]]:
    """Return the cameras as they are meant, and what was corrected; all of them must be written so.

    Args:
        entries: of one file, at least one.

    Raises:
        CalibrationInvalid: the focal lengths are in another unit than pixels.
    """
    names, found = [entry.name for entry in entries], []
    if all(_in_shares(entry) for entry in entries):
        entries = [replace(e, K=np.diag([*_size(e), 1.0]) @ e.K) for e in entries]
        found.append(diagnostic("intrinsics_in_shares", cameras=names))
    if all(e.image_size is not None and not e.fisheye and _is_short(e) for e in entries):
        shortest, longest = min(e.K[0, 0] for e in entries), max(e.K[0, 0] for e in entries)
        raise CalibrationInvalid(
            f"The focal lengths are {shortest:.3g} to {longest:.3g} px, which no lens has: they may be in mm.",
            hint="Write them in pixels: mm times the picture's width in pixels over the sensor's width in mm.",
        )
    if all(e.image_size is not None and (np.abs(e.K[:2, 2]) < OFF_MIDDLE * np.array(_size(e))).all() for e in entries):
        missing = not any(e.K[:2, 2].any() for e in entries)
        entries = [replace(e, K=_from_middle(e)) for e in entries]
        found.append(diagnostic("principal_points_missing" if missing else "principal_points_offsets", cameras=names))
    if any(e.rotation_vector is not None and np.linalg.norm(e.rotation_vector) > SURELY_DEGREES for e in entries):
        entries = [e if e.rotation_vector is None else replace(e, R=_of_degrees(e.rotation_vector)) for e in entries]
        found.append(diagnostic("rotations_in_degrees", cameras=names))
    if all(_is_mirrored(entry.R) for entry in entries):
        entries = [replace(e, R=e.R @ _MIRROR) for e in entries]
        found.append(diagnostic("world_left_handed", cameras=names))
    return list(entries), tuple(found)


def _size(entry: CameraEntry) -> tuple[int, int]:
    assert entry.image_size is not None
    return entry.image_size


def _in_shares(entry: CameraEntry) -> bool:
    return entry.image_size is not None and bool((entry.K[:2] >= 0).all() and 0 < entry.K[0, 0] < LARGEST_SHARE)


def _is_short(entry: CameraEntry) -> bool:
    return 0 < entry.K[0, 0] < SHORTEST_SHARE * _size(entry)[0]


def _from_middle(entry: CameraEntry) -> np.ndarray:
    K = entry.K.copy()
    K[:2, 2] += (np.array(_size(entry)) - 1) / 2
    return K


def _of_degrees(vector: np.ndarray) -> np.ndarray:
    return np.asarray(exp_so3(np.radians(vector)))


def _is_mirrored(R: np.ndarray) -> bool:
    """Whether a matrix is a rotation of a mirrored world."""
    return bool(np.isfinite(R).all() and np.abs(R @ R.T - np.eye(3)).max() < ROUNDING and np.linalg.det(R) < 0)
