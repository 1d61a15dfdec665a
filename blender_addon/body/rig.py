"""A body as Blender objects."""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np

from ..files.body_file import BodyFile
from .armature import create_armature
from .correctives import add_correctives
from .layout import lay_out_bones
from .mesh import create_mesh
from .shape import add_shape_keys, drive_joints


@dataclass(frozen=True)
class Rig:
    """The objects of one body."""

    armature: bpy.types.Object
    """24 bones to pose, and 24 hidden ones that deform."""
    mesh: bpy.types.Object
    """The skin, with ten shape sliders and the driven pose correctives."""


def create_rig(name: str, body: BodyFile, betas: np.ndarray, collection: bpy.types.Collection) -> Rig:
    """Create a posable body at rest, its pelvis at the world's origin; the sliders stand at ``betas``.

    Blender must be in object mode.

    Args:
        name: name of the armature.
        body: the body.
        betas: (10,) shape.
        collection: where the objects are linked; it must be part of the current view layer.
    """
    armature = create_armature(name, lay_out_bones(body, betas), collection)
    mesh = create_mesh(f"{name} body", body, armature)
    add_shape_keys(mesh, body, betas)
    drive_joints(armature, mesh, body, betas)
    add_correctives(armature, mesh, body)
    return Rig(armature, mesh)
