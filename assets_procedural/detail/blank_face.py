"""Replace eyes, nose, lips and ears of the mannequin by a smooth surface."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.interpolate import RBFInterpolator
from scipy.sparse.linalg import spsolve

from assets_procedural.arrays import Array, averaging, neighbour_graph

_FACE = np.array([0.0, 0.050, 0.105]), np.array([0.068, 0.088, 0.085])
_EAR = np.array([0.0835, 0.055, 0.000]), np.array([0.028, 0.050, 0.040])
"""Centre, from the head's joint, and radii of the ellipsoids to replace, metres. Chosen on the picture."""
_AROUND = 1.45  # Radii up to which the surrounding skin defines the surface. Chosen on the picture.
_MIDDLE = np.array([0.0, 0.060, 0.020])  # Centre of the radii that describe the head, from the head's joint, metres.


def blank_face(vertices: Array, faces: Array, head: Array) -> tuple[Array, Array]:
    """Return the vertices (N,) of a body at rest that move for a head without a face, and offsets (N, 3) in metres.

    Each vertex moves to the mean of its neighbours (Tutte 1963, "How to draw a graph"), and then along its ray from the
    head's centre to a thin-plate surface through the surrounding skin.
    """
    folded = (vertices - head) * np.where(vertices[:, :1] < 0, [-1.0, 1.0, 1.0], 1.0)
    away = np.min([np.linalg.norm((folded - c) / radii, axis=1) for c, radii in (_FACE, _EAR)], axis=0)
    free, around, centre = away < 1.0, (away >= 1.0) & (away < _AROUND), head + _MIDDLE
    chosen, count = np.flatnonzero(free), len(vertices)
    plate = sp.csr_matrix(averaging(neighbour_graph(faces, count)) - sp.eye(count))
    held = -plate[chosen][:, ~free] @ vertices[~free]
    even = spsolve(plate[chosen][:, chosen].tocsc(), held)
    radius, way = _rays(vertices[around] - centre)
    surface = RBFInterpolator(way, radius, kernel="thin_plate_spline", smoothing=1e-6)
    way = _rays(even - centre)[1]
    return chosen, centre + surface(way)[:, None] * way - vertices[chosen]


def _rays(points: Array) -> tuple[Array, Array]:
    length = np.linalg.norm(points, axis=1)
    return length, points / length[:, None]
