"""Mesh operations shared by the generator's modules: edges, normals, neighbours and smooth steps."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp

from solver_backend.body.mesh import face_normals

Array = np.ndarray
NUMBERS = Path(__file__).parent / "numbers"

NONE, LIPS, EYEBALL, IRIS, PUPIL, NAIL = range(6)  # Features that a face of the mesh can show.
FLIP = np.array([-1.0, 1.0, 1.0])  # Factor that mirrors a point at the plane x = 0.


def half_edges(faces: Array) -> Array:
    """Return the directed edges (3 T, 2) of (T, 3) faces."""
    return np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])


def edges_of(faces: Array) -> Array:
    """Return the edges (E, 2) without duplicates. Each edge starts with its lower vertex number."""
    return np.unique(np.sort(half_edges(faces), axis=1), axis=0)


def neighbour_graph(faces: Array, count: int) -> sp.csr_matrix:
    """Return the adjacency matrix (count, count): 1 for each pair of vertices with a common edge."""
    pairs = half_edges(faces)
    pairs = np.unique(np.concatenate([pairs, pairs[:, ::-1]]), axis=0)
    return sp.csr_matrix((np.ones(len(pairs)), pairs.T), shape=(count, count))


def averaging(graph: sp.csr_matrix) -> sp.csr_matrix:
    """Return the matrix that averages over neighbours: every row of ``graph`` divided by its sum."""
    return sp.csr_matrix(sp.diags(1.0 / np.asarray(graph.sum(axis=1)).ravel()) @ graph)


@cache
def table(name: str) -> dict[str, Any]:
    """Return a table by its name in ``numbers/tables.json``."""
    return json.loads((NUMBERS / "tables.json").read_text(encoding="utf-8"))[name]


def normal_sums(vertices: Array, faces: Array) -> Array:
    """Return the sum (V, 3) of the area-weighted normals (``face_normals``) of the faces around each vertex."""
    total, normals = np.zeros_like(vertices), face_normals(vertices, faces)
    for k in range(3):
        np.add.at(total, faces[:, k], normals)
    return total


def part_of(faces: Array, chosen: Array, count: int) -> Array:
    """Return the faces (Q, 3) that have only chosen vertices, which are renumbered. The mesh has ``count`` vertices."""
    number = np.full(count, -1)
    number[chosen] = np.arange(len(chosen))
    own = number[faces]
    return own[(own >= 0).all(axis=1)]


def smooth_step(x: Array, low: float, high: float) -> Array:
    """Return a smooth transition from 0 below ``low`` to 1 above ``high``."""
    t = np.clip((x - low) / (high - low), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)
