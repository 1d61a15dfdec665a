"""Cross-sections of a mesh as weights of its vertices: a section's centre moves with the skin, linearly."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from assets_procedural.arrays import Array


def section_centre(vertices: Array, faces: Array, near: Array, normal: Array) -> Array:
    """Return (V,) weights, summing to 1, of the centre of the section's outline whose centre is nearest to a point.

    Args:
        vertices: (V, 3) metres.
        faces: (T, 3).
        near: (3,) metres, a point of the plane.
        normal: (3,) of the plane.
    """
    height = (vertices - near) @ normal
    crossing = (height[faces] > 0).any(axis=1) & (height[faces] <= 0).any(axis=1)
    cut = faces[crossing]
    pairs = np.sort(np.stack([cut, np.roll(cut, -1, axis=1)], axis=-1), axis=-1)
    through = (height[pairs[..., 0]] > 0) != (height[pairs[..., 1]] > 0)
    edges = pairs[through].reshape(-1, 2, 2)
    _, number = np.unique(edges.reshape(-1, 2), axis=0, return_inverse=True)
    ends = number.reshape(-1, 2)
    count = ends.max() + 1
    loops = connected_components(sp.csr_matrix((np.ones(len(ends)), ends.T), shape=(count, count)), directed=False)[1]
    t = height[edges[..., 0]] / (height[edges[..., 0]] - height[edges[..., 1]])
    points = vertices[edges[..., 0]] * (1 - t)[..., None] + vertices[edges[..., 1]] * t[..., None]
    length, middle, loop = np.linalg.norm(points[:, 0] - points[:, 1], axis=1), points.mean(axis=1), loops[ends[:, 0]]
    total = np.bincount(loop, length)
    centres = np.stack([np.bincount(loop, length * middle[:, a]) for a in range(3)], axis=1) / total[:, None]
    chosen = int(np.linalg.norm(centres - near, axis=1).argmin())
    share = np.where(loop == chosen, length, 0.0)[:, None] / (2 * total[chosen])
    weights = np.zeros(len(vertices))
    np.add.at(weights, edges[..., 0], share * (1 - t))
    np.add.at(weights, edges[..., 1], share * t)
    return weights
