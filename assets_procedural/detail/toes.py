"""Toes: the fitted surface's own furrows between them, deepened."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from assets_procedural.arrays import Array
from assets_procedural.layout import JOINT

_FROM_M, _TO_M = 0.022, 0.040
"""Ahead of the foot's joint: where the deepening sets in and where it is whole."""
_SMOOTHINGS, _SHRINK, _SWELL = 9, 0.55, -0.58
"""Taubin 1995, "Curve and surface smoothing without shrinkage": forth and back, so that large forms stay."""
_GAIN, _MOST_M = 2.2, 0.004
_KEPT = (-1.0, -0.001, 0.0025), (1.0, 0.036, 0.041)
"""Inwards and outwards of the foot's joint, where the change fades: keypoints are cast on both outer toes."""
_SOLE_M = 0.006
"""Up to this height nothing is moved up or down, so that the soles stay on the floor."""


def part_toes(vertices: Array, faces: Array, joints: Array) -> Array:
    """Return the half body's vertices with what distinguishes them from a smoothed foot doubled at the toes.

    ``v + g (v - S v)``, S a number of averages over neighbours and g the share, an unsharp mask.

    Args:
        vertices: (V, 3) metres, x >= 0, floor at y = 0.
        faces: (T, 3).
        joints: (24, 3) metres, in the same frame.
    """
    foot = joints[JOINT["left_foot"]]
    ahead = (vertices[:, 2] - foot[2] + 0.30 * np.abs(vertices[:, 0] - foot[0] + 0.02) - _FROM_M) / (_TO_M - _FROM_M)
    t = np.clip(ahead, 0.0, 1.0) * ((vertices[:, 1] < 0.06) & (vertices[:, 2] > 0.1))
    share = t * t * (3.0 - 2.0 * t)
    mean = _average(faces, len(vertices))
    smooth = vertices
    for _ in range(_SMOOTHINGS):
        for step in (_SHRINK, _SWELL):
            smooth = smooth + step * (mean @ smooth - smooth)
    change = _GAIN * (vertices - smooth)
    change *= share[:, None] * np.minimum(1.0, _MOST_M / np.maximum(np.linalg.norm(change, axis=1), 1e-9))[:, None]
    change[:, 1] *= np.clip(vertices[:, 1] / _SOLE_M, 0.0, 1.0)
    for sign, low, high in _KEPT:
        aside = sign * (vertices[:, 0] - foot[0])
        change *= 1.0 - np.clip((aside - low) / (high - low), 0.0, 1.0)[:, None]
    change[:, 2] = np.minimum(change[:, 2], 0.0)  # the foot keeps its length
    return vertices + change


def _average(faces: Array, count: int) -> sp.csr_matrix:
    """Return (V, V): the mean of a vertex and its neighbours."""
    pairs = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    pairs = np.unique(np.concatenate([pairs, pairs[:, ::-1]]), axis=0)
    graph = sp.csr_matrix((np.ones(len(pairs)), pairs.T), shape=(count, count)) + sp.eye(count)
    return sp.csr_matrix(sp.diags(1.0 / np.asarray(graph.sum(axis=1)).ravel()) @ graph)
