"""Whether a take is a mirror image: left and right labels exchanged, or axes of the other hand."""

from __future__ import annotations

import numpy as np

from solver_backend.body.landmark_set import Landmarks
from solver_backend.exchange.errors import MarkersMirrored

TRUNK = ("C7", "T2", "T4", "T8", "T10", "T12", "CLAV", "STRN", "SACR", "SHO", "FSH", "BSH", "FWT", "BWT", "MWT")
"""Places that stay nearly rigid to each other, without their side."""
LEAST, FRAMES = 5, 40
"""Markers of the trunk, and frames, that are looked at."""
SHARE = 0.75
"""A mirror image fits by so much better, in the median of the frames."""


def check_handedness(points: np.ndarray, landmarks: Landmarks) -> None:
    """Make sure that the trunk's markers are no mirror image of where a body has them.

    Each frame's markers are laid over those of the rest pose by a rotation, and by a rotation with a reflection (Kabsch
    1976, with and without the sign of the determinant).

    Args:
        points: (F, L, 3) metres, NaN where missing.
        landmarks: the L places.

    Raises:
        MarkersMirrored: the reflection fits much better.
    """
    columns = [i for i, name in enumerate(landmarks.names) if name in TRUNK or name[1:] in TRUNK]
    frames = points[:, columns][np.unique(np.linspace(0, len(points) - 1, FRAMES).astype(int))]
    frames = frames[np.isfinite(frames).all((1, 2))]
    if len(columns) < LEAST or not len(frames):
        return
    rest = landmarks.anchors[columns].sum(axis=1)
    rest, frames = rest - rest.mean(axis=0), frames - frames.mean(axis=1, keepdims=True)
    U, S, Vt = np.linalg.svd(np.swapaxes(frames, 1, 2) @ rest)
    power = (frames**2).sum((1, 2)) + (rest**2).sum()
    proper = S[:, 0] + S[:, 1] + np.sign(np.linalg.det(U @ Vt)) * S[:, 2]
    improper = 2 * S[:, :2].sum(axis=1) - proper
    straight, mirrored = (np.sqrt(np.maximum(power - 2 * fit, 0)) for fit in (proper, improper))
    if np.median(mirrored / np.maximum(straight, 1e-9)) < SHARE:
        raise MarkersMirrored(
            "The markers of the trunk are a mirror image of a body's: left and right labels are exchanged, or an axis "
            "points the other way.", where="markers",
            hint="Exchange L and R in the labels, or export the take with right-handed axes.",
        )  # fmt: skip
