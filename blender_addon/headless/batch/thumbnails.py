"""A small picture of a take: its joints as stick figures at a few moments, drawn as one SVG without any program."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..._exchange.errors import MocapError
from ..._exchange.npz import read_arrays
from ...conventions.skeleton import PARENTS

WIDTH, HEIGHT = 220, 72
_MOMENTS = 5
_TALL_M = 2.0
"""What the picture's height shows."""


def thumbnail(motion: Path) -> str:
    """Return an SVG of a motion file's body at five moments, "" where there is none to be read.

    The figures stand side by side, seen along the horizontal direction in which they are narrowest.
    """
    try:
        joints = np.asarray(read_arrays(motion, required=("joints",))["joints"], dtype=np.float64)
    except (OSError, KeyError, ValueError, MocapError):
        return ""
    if joints.ndim != 3 or joints.shape[1:] != (len(PARENTS), 3) or not len(joints) or not np.isfinite(joints).all():
        return ""
    moments = np.unique(np.linspace(0, len(joints) - 1, _MOMENTS).round().astype(int))
    return stick_figures(joints[moments])


def stick_figures(joints: np.ndarray) -> str:
    """Return an SVG of (N, 24, 3) joints in metres, Z up."""
    scale, step = HEIGHT / _TALL_M, WIDTH / _MOMENTS
    ground = joints[..., 2].min()
    centred = joints[..., :2] - joints[:, :1, :2]
    flat = centred.reshape(-1, 2)
    _, _, axes = np.linalg.svd(flat - flat.mean(axis=0), full_matrices=False)
    across = centred @ axes[0]
    x = across * scale + step * (np.arange(len(joints))[:, None] + 0.5)
    y = HEIGHT - (joints[..., 2] - ground) * scale - 2
    bones = [(child, parent) for child, parent in enumerate(PARENTS) if parent >= 0]
    paths = "".join(
        "".join(f"M{x[n, a]:.1f} {y[n, a]:.1f}L{x[n, b]:.1f} {y[n, b]:.1f}" for a, b in bones)
        for n in range(len(joints))
    )
    return f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="poses of the take"><path d="{paths}"/></svg>'
