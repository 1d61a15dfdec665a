"""How the shape sliders move the joints: drivers on bones, as few variables as they can do with.

The drivers are simple expressions, which Blender evaluates itself: they work in files whose Python may not run. A file
keeps 950 bytes for each variable of a driver, and ten betas for each axis of each bone would be most of its rig. So a
location that is a combination of a few others that are driven already is driven by those.
"""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np

from ..conventions.skeleton import JOINTS, PARENTS
from .armature import deform_bone
from .body_file import BodyFile
from .controls.limbs import LIMBS
from .drivers import add_driver
from .layout import shape_directions
from .shape import all_sliders

_LEAST_M, _SAME_M = 5e-7, 5e-7
"""Metres per beta: a smaller effect is none, and two that differ by less are the same."""
_LARGEST_FACTOR = 4.0
"""Of a combination: larger ones would magnify what Blender rounds."""


@dataclass(frozen=True)
class _Driven:
    """One axis of a bone's location and how the betas move it."""

    bone: str
    axis: int
    row: np.ndarray


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
    moves: list[tuple[str, np.ndarray, tuple[str, ...]]] = [(n, from_parent[j], ()) for n, j in _moved_with_joints()]
    for j, joint in enumerate(JOINTS):
        moves.append((deform_bone(joint), -directions[j], (joint, deform_bone(JOINTS[max(PARENTS[j], 0)]))))
    driven: list[_Driven] = []
    for name, way, related in moves:
        bone = armature.pose.bones[name]
        axes = np.array(armature.data.bones[name].matrix_local.to_3x3(), np.float64)
        for axis, row in enumerate(axes.T @ way):
            if np.abs(row).max() <= _LEAST_M:
                continue
            others = [d for d in driven if d.bone != name]  # a bone that moved by itself would be a cycle
            parts = _one_other(row, others) or _combination(row, [d for d in others if d.bone in related])
            if parts:
                _drive_by_bones(bone, axis, armature, parts)
            else:
                drive_by_betas(bone, "location", axis, row, float(-row @ rest_betas), mesh)
            driven.append(_Driven(name, axis, row))


def _one_other(row: np.ndarray, driven: list[_Driven]) -> list[tuple[float, _Driven]]:
    """Return the driven location that moves as this one does but for a factor, nothing where there is none."""
    if not driven:
        return []
    rows = np.stack([d.row for d in driven])
    factors = rows @ row / (rows**2).sum(axis=1)
    off = np.abs(rows * factors[:, None] - row).max(axis=1)
    best = int(off.argmin())
    return [(float(factors[best]), driven[best])] if off[best] <= _SAME_M and _small(factors[best]) else []


def _combination(row: np.ndarray, related: list[_Driven]) -> list[tuple[float, _Driven]]:
    """Return related locations that together move as this one does, nothing where they do not or would save nothing."""
    if not related:
        return []
    rows = np.stack([d.row for d in related])
    factors = np.linalg.lstsq(rows.T, row, rcond=1e-6)[0]
    used = np.abs(factors)[:, None] * np.abs(rows) > _LEAST_M
    parts = [(float(f), d) for f, d, use in zip(factors, related, used.any(axis=1), strict=True) if use]
    found = sum((f * d.row for f, d in parts), np.zeros_like(row))
    fits = np.abs(found - row).max() <= _SAME_M and _small(factors)
    return parts if fits and len(parts) < np.sum(np.abs(row) > _LEAST_M) else []


def _small(factors: np.ndarray | float) -> bool:
    return bool(np.abs(factors).max() <= _LARGEST_FACTOR)


def _drive_by_bones(
    bone: bpy.types.PoseBone, axis: int, armature: bpy.types.Object, parts: list[tuple[float, _Driven]]
) -> None:
    """Drive a bone's location by others'."""
    driver = add_driver(bone, "location", axis)
    driver.type = "SCRIPTED"
    for k, (_, source) in enumerate(parts):
        variable = driver.variables.new()
        variable.name, variable.type = f"a{k}", "SINGLE_PROP"
        target = variable.targets[0]
        target.id_type, target.id = "OBJECT", armature
        target.data_path = f'pose.bones["{source.bone}"].location[{source.axis}]'
    driver.expression = "".join(f"{factor:+.7f}*a{k}" for k, (factor, _) in enumerate(parts)).lstrip("+")


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
    keys = all_sliders(mesh)
    driver = add_driver(owner, path, axis)
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
