"""A body as Blender objects."""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np

from ..conventions.skeleton import JOINTS
from .armature import create_armature
from .body_file import BodyFile
from .controls.shapes import add_control_shapes
from .correctives import add_correctives
from .layout import around_pelvis, lay_out_bones, shape_directions
from .looks import add_looks
from .mesh import create_mesh
from .shape import add_shape_keys, get_betas
from .shape_drivers import drive_by_betas, drive_joints


@dataclass(frozen=True)
class Rig:
    """The objects of one body."""

    armature: bpy.types.Object
    """A bone a joint to pose, a hidden one each that deforms, a root, and hands and feet to place."""
    mesh: bpy.types.Object
    """The skin, with ten shape sliders and pose correctives."""


def create_rig(name: str, body: BodyFile, betas: np.ndarray, collection: bpy.types.Collection) -> Rig:
    """Create a posable body at rest that stands on the world's origin; the sliders stand at ``betas``.

    Blender must be in object mode.

    Args:
        name: name of the armature.
        body: the body.
        betas: (10,) shape.
        collection: where the objects are linked; it must be part of the current view layer.
    """
    layout = lay_out_bones(body, betas)
    armature = create_armature(name, body.layout, layout, collection)
    hidden = add_control_shapes(armature, body, betas, layout)
    mesh = create_mesh(f"{name} body", body, armature)
    add_shape_keys(mesh, body, betas)
    add_looks(mesh, body)
    drive_joints(armature, mesh, body, betas)
    add_correctives(armature, mesh, body, hidden)
    return Rig(armature, mesh)


def stand_on_floor(rig: Rig, body: BodyFile) -> None:
    """Let the soles of the resting body stay at the height of the armature's origin, whatever the sliders are set to.

    The lowest vertex of the present shape drives the armature's delta location, so that its location stays free.
    """
    directions, _ = shape_directions(body)
    pelvis = np.array(rig.armature.data.bones[JOINTS[0]].head_local)
    vertices = around_pelvis(body, get_betas(rig.mesh), pelvis)
    lowest = int(vertices[:, 2].argmin())
    constant = vertices[lowest, 2] - directions[lowest, 2] @ get_betas(rig.mesh)
    drive_by_betas(rig.armature, "delta_location", 2, -directions[lowest, 2], float(-constant), rig.mesh)
