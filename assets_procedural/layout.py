"""Names, tree and borders that the whole generator shares."""

from __future__ import annotations

from assets_procedural.mesh.meshing import Plane
from solver_backend.types import SMPL_JOINTS

PARENTS = (-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21)
"""Parent of each of the 24 joints."""
JOINT = {name: index for index, name in enumerate(SMPL_JOINTS)}
"""Index of each joint by name."""
MIRROR_JOINT = tuple(
    JOINT[n.replace("left", "right") if n.startswith("left") else n.replace("right", "left")] for n in SMPL_JOINTS
)
"""Index of the joint on the other side; midline joints are their own."""
CHILDREN = tuple(tuple(c for c, p in enumerate(PARENTS) if p == j) for j in range(len(PARENTS)))
"""Children of each joint."""

NECKLINE = Plane((-0.55, 1.0, 0.42), 1.1776, (-1.0, 1.30, -0.3), (0.12, 1.55, 0.3))
"""Where the suit ends at the neck, lower in front and higher at the sides (left half)."""
CUFF = Plane((1.0, 0.0, 0.0), 0.655, (0.60, 1.0, -0.3), (0.71, 1.6, 0.3))
"""Where the sleeve ends, left side."""
ANKLE = Plane((0.0, 1.0, 0.0), 0.105, (-1.0, 0.06, -0.3), (1.0, 0.16, 0.3))
"""Where the trouser leg ends."""
BORDERS = (NECKLINE, CUFF, ANKLE)
"""Borders between the two materials on the half body x >= 0, metres, floor at y = 0."""
