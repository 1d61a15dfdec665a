"""Build a body as Blender objects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import bpy
import numpy as np

from ..conventions.nodes import add_scripted_driver
from ..conventions.skeleton import JOINTS, BodyLayout
from .armature import create_armature, deform_bone
from .body_file import BodyFile, once_a_body
from .controls.limbs import LIMBS
from .controls.shapes import add_control_shapes
from .correctives import add_correctives
from .layout import around_pelvis, lay_out_bones, shape_directions
from .looks import add_looks
from .mesh import create_mesh, polygons_of
from .shape import add_shape_keys, all_sliders, get_betas

_LEAST_M, _SAME_M = 5e-7, 5e-7  # Metres per beta below which effects are ignored, or are equal.
_MOST_OTHERS = 6
_LARGEST_FACTOR = 4.0
"""Largest factor in a linear combination. Larger factors would amplify Blender's rounding errors."""


@dataclass(frozen=True)
class _Driven:
    """One axis of a bone's location, and how the betas change it."""

    bone: str
    axis: int
    row: np.ndarray


def _drive_joints(armature: bpy.types.Object, mesh: bpy.types.Object, body: BodyFile, rest_betas: np.ndarray) -> None:
    """Add drivers that move the joints and the IK bones with the shape sliders.

    In its rest axes B_j, each posed bone moves by ``B_j^T (D_j - D_parent) (betas - rest_betas)``. Its deform bone
    moves back by ``-B_j^T D_j (betas - rest_betas)``, where ``D_j betas`` is the offset of joint j in a shape.
    """
    names = [name for name, _ in _moved_with_joints(body.layout)] + [deform_bone(joint) for joint in body.layout.joints]
    axes = [np.array(armature.data.bones[name].matrix_local.to_3x3(), np.float64) for name in names]
    for driven, parts in _sources(body, tuple(names), np.stack(axes).tobytes()):
        bone = armature.pose.bones[driven.bone]
        if parts:
            # Driven by the locations of other bones.
            variables = {
                f"a{k}": (armature, f'pose.bones["{source.bone}"].location[{source.axis}]')
                for k, (_, source) in enumerate(parts)
            }
            sums = "".join(f"{factor:+.7f}*a{k}" for k, (factor, _) in enumerate(parts)).lstrip("+")
            add_scripted_driver(bone, "location", driven.axis, sums, variables)
        else:
            _drive_by_betas(bone, "location", driven.axis, driven.row, float(-driven.row @ rest_betas), mesh)


@once_a_body
def _sources(body: BodyFile, names: tuple[str, ...], axes: bytes) -> list[tuple[_Driven, list[tuple[float, _Driven]]]]:
    """Return each bone location that the betas change, and a weighted sum of earlier locations that can drive it.

    Args:
        names: names of N bones: first each bone that moves relative to its parent, then the deform bone of each joint.
        axes: (N, 3, 3) rest axes of the bones in columns, as the bytes of a float64 array.
    """
    _, directions = shape_directions(body)
    joints, parents = body.layout.joints, body.layout.parents
    from_parent = directions - np.where(np.array(parents)[:, None, None] >= 0, directions[list(parents)], 0.0)
    ways = [(from_parent[j], ()) for _, j in _moved_with_joints(body.layout)]
    ways += [(-directions[j], (n, deform_bone(joints[max(parents[j], 0)]))) for j, n in enumerate(joints)]
    found: list[tuple[_Driven, list[tuple[float, _Driven]]]] = []
    for name, B, (way, related) in zip(names, np.frombuffer(axes).reshape(-1, 3, 3), ways, strict=True):
        earlier = [driven for driven, _ in found]  # because a bone that drives itself would be a cycle
        for axis, row in enumerate(B.T @ way):
            if np.abs(row).max() > _LEAST_M:
                parts = _few_others(row, earlier) or _all_of(row, [d for d in earlier if d.bone in related])
                found.append((_Driven(name, axis, row), parts))
    return found


def _few_others(row: np.ndarray, driven: Sequence[_Driven]) -> list[tuple[float, _Driven]]:
    """Express ``row`` (change per beta) as a sum of a few driven locations with factors. Return [] if impossible.

    Orthogonal matching pursuit (Pati, Rezaiifar and Krishnaprasad 1993) adds the most similar location in each step.
    """
    if not driven:
        return []
    rows = np.stack([d.row for d in driven])
    length = np.linalg.norm(rows, axis=1)
    chosen: list[int] = []
    basis, left = np.zeros((0, len(row))), row
    for _ in range(min(len(driven), int(np.sum(np.abs(row) > _LEAST_M)) - 1, _MOST_OTHERS)):
        likeness = np.abs(rows @ left) / length
        likeness[chosen] = -1.0
        chosen.append(int(likeness.argmax()))
        new = rows[chosen[-1]] - (rows[chosen[-1]] @ basis.T) @ basis
        basis = np.concatenate([basis, new[None] / max(float(np.linalg.norm(new)), 1e-12)])
        left = row - (row @ basis.T) @ basis
        if np.abs(left).max() <= _SAME_M:
            factors = np.linalg.lstsq(rows[chosen].T, row, rcond=None)[0]
            fits = np.abs(factors).max() <= _LARGEST_FACTOR
            return [(float(f), driven[k]) for f, k in zip(factors, chosen, strict=True)] if fits else []
    return []


def _all_of(row: np.ndarray, related: list[_Driven]) -> list[tuple[float, _Driven]]:
    """Express ``row`` as a sum of related locations. Return [] if inaccurate or as long as the sum of betas."""
    if not related:
        return []
    rows = np.stack([d.row for d in related])
    factors = np.linalg.lstsq(rows.T, row, rcond=1e-6)[0]
    used = (np.abs(factors)[:, None] * np.abs(rows) > _LEAST_M).any(axis=1)
    parts = [(float(f), d) for f, d, use in zip(factors, related, used, strict=True) if use]
    found = sum((f * d.row for f, d in parts), np.zeros_like(row))
    fits = np.abs(found - row).max() <= _SAME_M and np.abs(factors).max() <= _LARGEST_FACTOR
    return parts if fits and len(parts) < np.sum(np.abs(row) > _LEAST_M) else []


def _moved_with_joints(layout: BodyLayout) -> list[tuple[str, int]]:
    index = {joint: j for j, joint in enumerate(layout.joints)}
    solved = (pair for limb in LIMBS for pair in zip((*limb.solved, limb.reach), limb.joints, strict=True))
    return [*index.items(), *((name, index[joint]) for name, joint in solved)]


def _drive_by_betas(
    owner: bpy.types.bpy_struct, path: str, axis: int, row: np.ndarray, constant: float, mesh: bpy.types.Object
) -> bool:
    """Drive one element by ``constant + row @ betas``. Return False if the betas have no effect on it."""
    used = np.flatnonzero(np.abs(row) > _LEAST_M).tolist()
    if not used:
        return False
    keys, data = all_sliders(mesh), mesh.data.shape_keys
    variables = {f"b{k}": (data, f'key_blocks["{keys[k].name}"].value') for k in used}
    # Blender keeps only 256 characters of an expression, so values in metres have seven decimals.
    terms = "".join(f"{row[k]:+.7f}*b{k}" for k in used)
    add_scripted_driver(owner, path, axis, f"{constant:.7f}{terms}", variables)
    return True


@dataclass(frozen=True)
class Rig:
    """Armature and mesh of a body in Blender."""

    armature: bpy.types.Object  # Posed and hidden deform bones, a root, and IK controls for hands and feet.
    mesh: bpy.types.Object  # The skin, with ten shape sliders and the pose correctives.


def create_rig(name: str, body: BodyFile, betas: np.ndarray, collection: bpy.types.Collection) -> Rig:
    """Create a posable body in a (10,) shape at the world origin. Blender must be in object mode."""
    layout = lay_out_bones(body, betas)
    armature = create_armature(name, body.layout, layout, collection)
    hidden = add_control_shapes(armature, body, betas, layout)
    mesh = create_mesh(f"{name} body", body, armature)
    add_shape_keys(mesh, body, betas)
    add_looks(mesh, body, polygons_of(body)[1])
    _drive_joints(armature, mesh, body, betas)
    add_correctives(armature, mesh, body, hidden)
    return Rig(armature, mesh)


def stand_on_floor(rig: Rig, body: BodyFile) -> None:
    """Add a driver that keeps the soles at the height of the armature's origin while the body is at rest."""
    directions, _ = shape_directions(body)
    pelvis = np.array(rig.armature.data.bones[JOINTS[0]].head_local)
    vertices = around_pelvis(body, get_betas(rig.mesh), pelvis)
    lowest = int(vertices[:, 2].argmin())
    constant = vertices[lowest, 2] - directions[lowest, 2] @ get_betas(rig.mesh)
    _drive_by_betas(rig.armature, "delta_location", 2, -directions[lowest, 2], float(-constant), rig.mesh)
