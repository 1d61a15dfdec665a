"""Pose correctives: shape keys driven by the bones' rotations, so that the skin is the model's and not plain blending.

The model adds ``P flatten(R_j - I)`` to the rest shape (Loper et al. 2015, eq. 9). Each element of a joint's rotation
matrix is one shape key, driven by a simple expression of the pose bone's quaternion, constraints included.
"""

from __future__ import annotations

import bpy
import numpy as np

from ..conventions.coordinates import R_ARMATURE_BODY
from ..conventions.skeleton import JOINTS
from .armature import rotation_from_body_axes
from .body_file import BodyFile
from .mesh import positions
from .shape import add_key

_FEATURES = (
    "-2*(y*y+z*z)", "2*(x*y-w*z)", "2*(x*z+w*y)",
    "2*(x*y+w*z)", "-2*(x*x+z*z)", "2*(y*z-w*x)",
    "2*(x*z-w*y)", "2*(y*z+w*x)", "-2*(x*x+y*y)",
)  # fmt: skip
"""``R - I`` of a unit quaternion, row-major."""
_LARGEST_FEATURE = 2.0
_LEAST_M = 5e-5
"""Keys that never move a vertex this far are left out."""


def add_correctives(armature: bpy.types.Object, mesh: bpy.types.Object, body: BodyFile) -> int:
    """Add the body's pose correctives as driven shape keys and return how many there are.

    Args:
        armature: from ``create_armature``.
        mesh: its mesh, with a basis.
        body: the body; without correctives nothing is added.
    """
    if body.posedirs is None:
        return 0
    added = 0
    C, rest = rotation_from_body_axes(armature), positions(mesh.data.vertices)
    blocks = body.posedirs.astype(np.float32).reshape(len(rest), 3, -1, 9).transpose(2, 0, 1, 3).copy()
    for joint, block, axes in zip(JOINTS[1:], blocks, C[1:], strict=True):
        moved = np.flatnonzero(block.reshape(len(rest), -1).any(axis=1))
        offsets = _in_bone_axes(block[moved], axes)
        for m, feature in enumerate(_FEATURES):
            if _LARGEST_FEATURE * np.linalg.norm(offsets[:, :, m], axis=1).max(initial=0.0) < _LEAST_M:
                continue
            shaped = rest.copy()
            shaped[moved] += offsets[:, :, m]
            _drive(add_key(mesh, f"{joint} {m}", shaped, _LARGEST_FEATURE), feature, armature, joint)
            added += 1
    return added


def _in_bone_axes(block: np.ndarray, C: np.ndarray) -> np.ndarray:
    """Return (V, 3, 9) directions per element of ``C (R - I) C^T`` from those per element of ``R - I``."""
    rotated = R_ARMATURE_BODY @ block.astype(np.float64)
    return np.einsum("vkab,ia,jb->vkij", rotated.reshape(-1, 3, 3, 3), C, C, optimize=True).reshape(block.shape)


def _drive(key: bpy.types.ShapeKey, feature: str, armature: bpy.types.Object, joint: str) -> None:
    driver = key.driver_add("value").driver
    driver.type = "SCRIPTED"
    for axis in "wxyz":
        if axis not in feature:
            continue
        variable = driver.variables.new()
        variable.name, variable.type = axis, "TRANSFORMS"
        target = variable.targets[0]
        target.id, target.bone_target = armature, joint
        target.transform_type, target.rotation_mode = f"ROT_{axis.upper()}", "QUATERNION"
        target.transform_space = "LOCAL_SPACE"
    driver.expression = feature
