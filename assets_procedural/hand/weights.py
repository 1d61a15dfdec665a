"""Skinning weights of the fingers: what wrist and hand carry of the skin is shared out among the hand's bones.

The shares are heat weights (Baran, Popovic 2007) on the hand alone. Their sum stays what wrist and hand carry of each
vertex, so that a body whose fingers are at rest is skinned as one without finger joints.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from assets_procedural.arrays import Array
from assets_procedural.hand.tree import FIRST, LEFT, MIRROR, WRIST, left_bones
from assets_procedural.skeleton.skinning import MAX_INFLUENCES, cotangent_laplacian, distance_to_segment

_FLOW = 3.0
"""How sharply heat keeps to the nearest bone."""
_SMALLEST = 0.01
"""Shares below this are left out."""
_BONES = 4
"""Bones of a hand that carry a vertex, at most: what glTF and game engines keep."""


def hand_weights(
    vertices: Array, faces: Array, weights: Array, joints: Array, tips: Array, mirror: Array
) -> Array:  # fmt: skip
    """Return (V, 52) weights.

    Args:
        vertices: (V, 3) rest vertices, metres.
        faces: (T, 3).
        weights: (V, 24) of the body without finger joints.
        joints: (52, 3) metres.
        tips: (10, 3) metres.
        mirror: (V,) index of each vertex's mirror image.
    """
    out = np.zeros((len(vertices), len(joints)))
    out[:, :FIRST] = weights[:, :FIRST]
    carried = weights[:, WRIST] + weights[:, FIRST]
    chosen = np.nonzero(carried)[0]
    shares = _heat_shares(vertices, faces, chosen, left_bones(joints, tips[:5]))
    others = np.count_nonzero(weights[chosen], axis=1) - np.count_nonzero(weights[chosen][:, [WRIST, FIRST]], axis=1)
    shares = _keep_strongest(shares, np.minimum(_BONES, MAX_INFLUENCES - others))
    left = np.array([WRIST, *LEFT])
    out[chosen[:, None], left] = carried[chosen, None] * shares
    out[mirror[chosen][:, None], np.array(MIRROR)[left]] = out[chosen[:, None], left]
    return out


def _heat_shares(vertices: Array, faces: Array, chosen: Array, bones: dict[int, list[tuple[Array, Array]]]) -> Array:
    """Return (N, B) heat weights of the chosen vertices, their piece of the mesh alone."""
    number = np.full(len(vertices), -1)
    number[chosen] = np.arange(len(chosen))
    own = number[faces]
    points, own = vertices[chosen], own[(own >= 0).all(axis=1)]
    distance = np.stack([np.min([distance_to_segment(points, *s) for s in segments], 0) for segments in bones.values()])
    nearest = distance.min(axis=0)
    owner = distance <= nearest + 1e-9
    owner = owner / owner.sum(axis=0)
    laplacian, area = cotangent_laplacian(points, own)
    heat = sp.diags(_FLOW * np.maximum(area, 1e-9) / nearest**2)
    solve = splu((laplacian + heat).tocsc()).solve
    return np.stack([solve(heat @ row) for row in owner], axis=1).clip(0.0)


def _keep_strongest(shares: Array, most: Array) -> Array:
    shares = np.where(shares < _SMALLEST, 0.0, shares - _SMALLEST)
    limit = np.take_along_axis(-np.sort(-shares, axis=1), most[:, None], axis=1)
    kept = np.where(shares > limit, shares, 0.0)
    return kept / kept.sum(axis=1, keepdims=True)
