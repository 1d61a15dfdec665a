"""Cameras of a file as they are meant, where as written no camera can be so: shares of the picture, mirrored worlds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from solver_backend.exchange.diagnostics import Diagnostic, diagnostic
from solver_backend.io.calibration.entry import ROUNDING, CameraEntry

LARGEST_SHARE = 10.0
"""Focal length up to which it is in widths of the picture: the longest lenses have 8, the shortest in pixels 100."""
_MIRROR = np.diag([-1.0, 1.0, 1.0])


def meant_entries(entries: Sequence[CameraEntry]) -> tuple[list[CameraEntry], tuple[Diagnostic, ...]]:
    """Return the cameras as they are meant, and what was corrected; all of them must be written so.

    Args:
        entries: of one file, at least one.
    """
    names, found = [entry.name for entry in entries], []
    if all(_in_shares(entry) for entry in entries):
        entries = [replace(e, K=np.diag([*_size(e), 1.0]) @ e.K) for e in entries]
        found.append(diagnostic("intrinsics_in_shares", cameras=names))
    if all(e.image_size is not None and not e.K[:2, 2].any() for e in entries):
        entries = [replace(e, K=_with_middle(e)) for e in entries]
        found.append(diagnostic("principal_points_missing", cameras=names))
    if all(_is_mirrored(entry.R) for entry in entries):
        entries = [replace(e, R=e.R @ _MIRROR) for e in entries]
        found.append(diagnostic("world_left_handed", cameras=names))
    return list(entries), tuple(found)


def _size(entry: CameraEntry) -> tuple[int, int]:
    assert entry.image_size is not None
    return entry.image_size


def _in_shares(entry: CameraEntry) -> bool:
    return entry.image_size is not None and bool((entry.K[:2] >= 0).all() and 0 < entry.K[0, 0] < LARGEST_SHARE)


def _with_middle(entry: CameraEntry) -> np.ndarray:
    K = entry.K.copy()
    K[:2, 2] = (np.array(_size(entry)) - 1) / 2
    return K


def _is_mirrored(R: np.ndarray) -> bool:
    """Whether a matrix is a rotation of a mirrored world."""
    return bool(np.isfinite(R).all() and np.abs(R @ R.T - np.eye(3)).max() < ROUNDING and np.linalg.det(R) < 0)
