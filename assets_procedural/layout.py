"""Joint names, joint tree and material borders for the whole generator."""

from __future__ import annotations

from assets_procedural.mesh.meshing import Plane
from solver_backend.exchange.body_layout import SMPL

PARENTS = SMPL.parents  # Parent of each joint.
JOINT = {name: index for index, name in enumerate(SMPL.joints)}  # Index of each joint, by name.
MIRROR_JOINT = SMPL.mirror  # Index of the joint on the opposite side. Joints on the midline map to themselves.
CHILDREN = SMPL.children  # Children of each joint.

NECKLINE = Plane((-0.55, 1.0, 0.42), 1.1776, (-1.0, 1.30, -0.3), (0.12, 1.55, 0.3))  # Lower in front, left half.
CUFF = Plane((1.0, 0.0, 0.0), 0.655, (0.60, 1.0, -0.3), (0.71, 1.6, 0.3))  # End of the sleeve on the left side.
ANKLE = Plane((0.0, 1.0, 0.0), 0.105, (-1.0, 0.06, -0.3), (1.0, 0.16, 0.3))  # End of the trouser leg.
BORDERS = (NECKLINE, CUFF, ANKLE)  # Borders between the two materials on the half body x >= 0. Metres, floor at y = 0.
