"""The ten shape sliders: shape keys of the mesh whose values also drive the joints.

The drivers are simple expressions, which Blender evaluates itself: they work in files whose Python may not run.
"""

from __future__ import annotations

import bpy
import numpy as np

from .._exchange.errors import BodyInvalid
from ..conventions.skeleton import JOINTS, NUM_BETAS, PARENTS
from .armature import deform_bone
from .body_file import BodyFile
from .controls.limbs import LIMBS
from .layout import shape_directions
from .mesh import positions
from .shape_names import shape_names
from .sliders import slider_name, sliders

LARGEST_BETA = 5.0
"""Sliders reach this many standard deviations either way."""
_LEAST_M, _SAME_M = 5e-7, 5e-7
"""Metres per beta: a smaller effect is none, and two that differ by less are the same."""


def add_shape_keys(mesh: bpy.types.Object, body: BodyFile, betas: np.ndarray) -> None:
    """Add the basis and ten sliders to a mesh from ``create_mesh`` and set them to a shape."""
    directions, _ = shape_directions(body)
    mesh.shape_key_add(name="Basis", from_mix=False)
    rest = positions(mesh.data.vertices)
    for k, effect in enumerate(shape_names(body)):
        add_key(mesh, slider_name(k, effect), rest + directions[:, :, k], LARGEST_BETA)
    set_betas(mesh, betas)


def add_key(mesh: bpy.types.Object, name: str, shaped: np.ndarray, limit: float) -> bpy.types.ShapeKey:
    """Add a relative shape key that moves the vertices from rest to these positions at a value of 1.

    Args:
        mesh: a mesh object with a basis.
        name: name of the key.
        shaped: (V, 3) metres.
        limit: values reach from -limit to limit.
    """
    key = mesh.shape_key_add(name=name, from_mix=False)
    key.slider_min, key.slider_max, key.value = -limit, limit, 0.0
    key.points.foreach_set("co", np.ascontiguousarray(shaped, dtype=np.float32).ravel())
    return key


def drive_joints(armature: bpy.types.Object, mesh: bpy.types.Object, body: BodyFile, rest_betas: np.ndarray) -> None:
    """Let the sliders move the joints, and the bones that IK poses in their places.

    In its own rest axes B_j each posed bone moves by ``B_j^T (D_j - D_parent) (betas - rest_betas)``, and its deform
    bone back by ``-B_j^T D_j (betas - rest_betas)``, where ``D_j betas`` is how far a shape moves joint j.

    Args:
        armature: from ``create_armature``, laid out for ``rest_betas``.
        mesh: its mesh, with sliders.
        body: the body.
        rest_betas: (10,) the shape at which nothing is moved.
    """
    _, directions = shape_directions(body)
    from_parent = directions - np.where(np.array(PARENTS)[:, None, None] >= 0, directions[list(PARENTS)], 0.0)
    moves = [(name, from_parent[j]) for name, j in _moved_with_joints()]
    moves += [(deform_bone(joint), -directions[j]) for j, joint in enumerate(JOINTS)]
    driven: list[tuple[str, int, np.ndarray]] = []
    for name, way in moves:
        bone = armature.pose.bones[name]
        axes = np.array(armature.data.bones[name].matrix_local.to_3x3(), np.float64)
        for axis, row in enumerate(axes.T @ way):
            like = _same_or_opposite(row, driven)
            if like is not None:
                _drive_by_bone(bone, axis, armature, *like)
            elif drive_by_betas(bone, "location", axis, row, float(-row @ rest_betas), mesh):
                driven.append((name, axis, row))


def _same_or_opposite(row: np.ndarray, driven: list[tuple[str, int, np.ndarray]]) -> tuple[str, int, str] | None:
    """Return bone, axis and sign of a driven location that moves as this one does, or against it."""
    if np.abs(row).max() <= _LEAST_M:
        return None
    for name, axis, other in driven:
        for sign, opposite in (("", other), ("-", -other)):
            if np.abs(row - opposite).max() <= _SAME_M:
                return name, axis, sign
    return None


def _drive_by_bone(
    bone: bpy.types.PoseBone, axis: int, armature: bpy.types.Object, source: str, source_axis: int, sign: str
) -> None:
    """Drive a bone's location by another's: a file keeps 950 bytes for each variable of a driver, ten for the betas."""
    driver = bone.driver_add("location", axis).driver
    driver.type, driver.expression = "SCRIPTED", f"{sign}a"
    variable = driver.variables.new()
    variable.name, variable.type = "a", "SINGLE_PROP"
    target = variable.targets[0]
    target.id_type, target.id = "OBJECT", armature
    target.data_path = f'pose.bones["{source}"].location[{source_axis}]'


def _moved_with_joints() -> list[tuple[str, int]]:
    """Return names of bones that move against their parents as a joint does against its own, and that joint's index."""
    named = [(joint, j) for j, joint in enumerate(JOINTS)]
    for limb in LIMBS:
        named += [
            (name, JOINTS.index(joint)) for name, joint in zip((*limb.solved, limb.reach), limb.joints, strict=True)
        ]
    return named


def drive_by_betas(
    owner: bpy.types.bpy_struct, path: str, axis: int, row: np.ndarray, constant: float, mesh: bpy.types.Object
) -> bool:
    """Drive one element of a property by ``constant + row @ betas``; False where no beta has an effect.

    Args:
        owner: what the property belongs to.
        path: the property, an array.
        axis: its element.
        row: (10,) metres per beta.
        constant: metres.
        mesh: the mesh that has the sliders.
    """
    used = np.flatnonzero(np.abs(row) > _LEAST_M).tolist()
    if not used:
        return False
    keys = _sliders(mesh)
    driver = owner.driver_add(path, axis).driver
    driver.type = "SCRIPTED"
    for k in used:
        variable = driver.variables.new()
        variable.name, variable.type = f"b{k}", "SINGLE_PROP"
        target = variable.targets[0]
        target.id_type, target.id = "KEY", mesh.data.shape_keys
        target.data_path = f'key_blocks["{keys[k].name}"].value'
    # Blender keeps 256 characters of an expression; a tenth of a micrometre is exact enough.
    driver.expression = f"{constant:.7f}" + "".join(f"{row[k]:+.7f}*b{k}" for k in used)
    return True


def get_betas(mesh: bpy.types.Object) -> np.ndarray:
    """Return the (10,) shape a body's sliders show.

    Raises:
        BodyInvalid: the object is no body of ours.
    """
    return np.array([key.value for key in _sliders(mesh)])


def set_betas(mesh: bpy.types.Object, betas: np.ndarray) -> None:
    """Set the sliders; skin and joints follow.

    Args:
        mesh: the body's mesh object.
        betas: (10,) shape; the sliders widen where a value lies beyond their ends.

    Raises:
        BodyInvalid: the object is no body of ours.
    """
    for key, beta in zip(_sliders(mesh), np.asarray(betas, dtype=np.float64).tolist(), strict=True):
        key.slider_min, key.slider_max = min(key.slider_min, beta), max(key.slider_max, beta)
        key.value = beta


def _sliders(mesh: bpy.types.Object) -> list[bpy.types.ShapeKey]:
    found = sliders(mesh)
    if len(found) < NUM_BETAS:
        names = f"{slider_name(0)} to {slider_name(NUM_BETAS - 1)}"
        raise BodyInvalid(f"The object lacks the shape keys {names}.", where=mesh.name, hint="Choose a body's mesh.")
    return found
