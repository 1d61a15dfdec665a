"""Oriented samples of a surface: density, visibility, signed distance and the closing of narrow gaps."""

from __future__ import annotations

from typing import Any

import numpy as np
import trimesh
from scipy.ndimage import distance_transform_edt, gaussian_filter
from scipy.spatial import KDTree
from skimage.measure import marching_cubes


def sample_density(points: np.ndarray) -> np.ndarray:
    """Return how much denser than on the trunk each (N, 3) point is sampled."""
    x, y, z = np.abs(points[:, 0]), points[:, 1], points[:, 2]
    face = (y > 1.49) & (y < 1.62) & (z > 0.09)
    return np.select([face, (y > 1.47) | (x > 0.69) | (y < 0.06)], [30.0, 5.0], 1.0)


def visible(points: np.ndarray, cell: float = 0.003, depth: float = 0.003, views: int = 80) -> np.ndarray:
    """Mark the points that some outside view sees, so that mouth, nostrils and sockets stay closed."""
    seen = np.zeros(len(points), dtype=bool)
    directions = np.random.default_rng(3).normal(size=(views, 3))
    for d in directions / np.linalg.norm(directions, axis=1, keepdims=True):
        u = np.cross(d, [0.3, 1.0, 0.2])
        u /= np.linalg.norm(u)
        a, b, z = (points @ u / cell).astype(int), (points @ np.cross(d, u) / cell).astype(int), points @ d
        a, b = a - a.min(), b - b.min()
        buffer = np.full((a.max() + 3, b.max() + 3), -np.inf)
        for da, db in np.ndindex(2, 2):
            np.maximum.at(buffer, (a + da, b + db), z)
        seen |= z > buffer[a, b] - depth
    return seen


def fold(points: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return samples of the right half mirrored onto the left one."""
    flip = np.where(points[:, :1] < 0, np.array([[-1.0, 1.0, 1.0]]), 1.0)
    return points * flip, normals * flip


def signed_distance(points: np.ndarray, normals: np.ndarray, query: np.ndarray) -> np.ndarray:
    """Return the (Q,) distance to oriented samples, negative inside, metres."""
    distance, nearest = KDTree(points).query(query)
    outside = np.einsum("qa,qa->q", query - points[nearest], normals[nearest]) > 0
    return np.where(outside, distance, -distance)


def close_gaps(
    points: np.ndarray,
    normals: np.ndarray,
    whole: tuple[np.ndarray, np.ndarray],
    low: np.ndarray,
    high: np.ndarray,
    radius: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Return samples in which gaps inside a box are filled: dilated and eroded by ``radius`` on a fine grid.

    ``whole`` holds the samples of the entire closed surface, hidden walls included, which separate inside from outside.
    """
    cell, pad = float(np.clip(radius / 4, 0.0006, 0.001)), radius + 0.006
    axes = [np.arange(a - pad, b + pad, cell) for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
    flip = np.array([-1.0, 1.0, 1.0])
    both = np.concatenate([whole[0], whole[0] * flip]), np.concatenate([whole[1], whole[1] * flip])
    near = np.all((both[0] > low - 2 * pad) & (both[0] < high + 2 * pad), axis=1)
    distance = signed_distance(both[0][near], both[1][near], grid.reshape(-1, 3)).reshape(grid.shape[:3])
    depth: Any = distance_transform_edt(distance < radius)
    closed = radius - cell * depth
    closed = gaussian_filter(np.where(distance >= radius, distance, closed), 1.1)
    found: Any = marching_cubes(closed, 0.0, spacing=(cell,) * 3)
    vertices, faces = found[0], found[1]
    mesh = trimesh.Trimesh(vertices + low - pad, faces[:, ::-1])
    box = np.all((points > low) & (points < high), axis=1)
    drawn: Any = trimesh.sample.sample_surface(mesh, 3 * int(box.sum()), seed=2)
    new, normal = np.asarray(drawn[0]), np.asarray(mesh.face_normals)[drawn[1]]
    keep = np.all((new > low) & (new < high), axis=1)
    new, normal = new[keep], normal[keep]
    seen = visible(np.concatenate([new, points[~box], points[~box] * flip]))[: len(new)]
    close = KDTree(points[box]).query(new)[0] < radius + 0.001  # leaves out the walls of hidden hollows
    new, normal = new[seen & close], normal[seen & close]
    nearest = KDTree(points).query(new)[1]
    agreement = np.einsum("na,na->n", normal, normals[nearest])
    normal = normal * (1.0 if np.median(agreement) > 0 else -1.0)
    return np.concatenate([points[~box], new]), np.concatenate([normals[~box], normal])
