"""Find the bones that each control of a rig moves, by moving each control once.

There may be any number of helper bones, constraints and drivers between two controls of a rig. Each control is rotated
once and shifted once. If another control follows as if rigidly attached, the moved control carries it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Matrix, Quaternion, Vector

from ..errors import TargetUnsuitable
from ..scene.session import alone

_PROBE = Quaternion(Vector((0.36, 0.48, 0.8)), 0.5)
_PROBE_SHIFT = Vector((0.06, -0.05, 0.07))
"""Test shift of each control, as a fraction of the rig's size."""
_ALIKE_TURN, _ALIKE_SHIFT = 0.02, 0.02  # Differences to ignore, in radians and as a fraction of a shift.
_POSE = ("location", "rotation_quaternion", "rotation_euler", "rotation_axis_angle", "scale")


@dataclass(frozen=True)
class Hanging:
    """For each of N controls in the neutral pose, the control that moves it and the control that rotates it.

    Each control follows the controls that move or rotate it.
    """

    names: tuple[str, ...]
    matrices: np.ndarray  # (N, 4, 4) pose matrices.
    turns_with: np.ndarray  # (N,) index of the control that rotates each one, or -1.
    moves_with: np.ndarray  # (N,) index of the control that moves each one, or -1.
    held: tuple[str, ...]  # Controls that do not rotate when their own channels change.
    unmoved: tuple[str, ...]  # Controls that do not move when their own location changes.
    partial: tuple[str, ...]  # Controls that only partly follow another, for example through half a constraint.


def hanging_of(
    armature: bpy.types.Object, scene: bpy.types.Scene, names: Sequence[str], switches: dict[tuple[str, str], float]
) -> Hanging:
    """Return the dependencies between controls, found by moving each control once."""
    with neutral(armature, names, switches), alone(armature, scene) as (stage, depsgraph):
        layer = stage.view_layers[0]

        def look() -> np.ndarray:
            layer.update()
            bones = armature.evaluated_get(depsgraph).pose.bones
            return np.array([bones[name].matrix for name in names], np.float64)

        before = look()
        size = float(np.ptp(before[:, :3, 3], axis=0).max())
        after = np.empty((len(names), *before.shape))
        for d, name in enumerate(names):
            bone = armature.pose.bones[name]
            rest = bone.matrix_basis.copy()
            bone.matrix_basis = Matrix.LocRotScale(size * _PROBE_SHIFT, _PROBE, None)
            after[d] = look()
            bone.matrix_basis = rest
    return _hanging(tuple(names), before, after, size)


@contextmanager
def neutral(armature: bpy.types.Object, names: Sequence[str], switches: dict[tuple[str, str], float]) -> Iterator[None]:
    """Within a ``with`` block, stop a rig's animation, put its controls at rest and set its switches."""
    animation, data = armature.animation_data, armature.data
    bones = [armature.pose.bones[name] for name in names]
    poses = [{key: tuple(getattr(bone, key)) for key in _POSE} for bone in bones]
    values = {(bone, key): armature.pose.bones[bone][key] for bone, key in switches}
    playing = None if animation is None else (animation.action, getattr(animation, "action_slot", None))
    nla, shown = animation is not None and animation.use_nla, data.pose_position
    try:
        if shown == "REST":
            try:
                data.pose_position = "POSE"
            except (AttributeError, TypeError) as error:
                message, hint = "The armature is in rest position.", "Set it to pose position in its own file."
                raise TargetUnsuitable(message, where=armature.name, hint=hint) from error
        if animation is not None:
            animation.action, animation.use_nla = None, False
        for bone in bones:
            bone.matrix_basis = Matrix()
        set_switches(armature, switches)
        yield
    finally:
        for bone, pose in zip(bones, poses, strict=True):
            for key, value in pose.items():
                setattr(bone, key, value)
        set_switches(armature, values)
        if animation is not None and playing is not None:
            animation.use_nla = nla
            animation.action = playing[0]
            if playing[0] is not None and playing[1] is not None:
                animation.action_slot = playing[1]
        if data.pose_position != shown:
            data.pose_position = shown


def set_switches(armature: bpy.types.Object, values: dict[tuple[str, str], float]) -> None:
    """Set custom properties of an armature's bones, given by (bone, key). Property types do not change."""
    for (bone, key), value in values.items():
        armature.pose.bones[bone][key] = type(armature.pose.bones[bone][key])(value)
    armature.update_tag()


def _hanging(names: tuple[str, ...], before: np.ndarray, after: np.ndarray, size: float) -> Hanging:
    """Derive the dependencies. ``after[d, c]`` is the pose of control c after a change of control d."""
    count = range(len(names))
    turned = np.einsum("dcij,ckj->dcik", bone_rotations(after), bone_rotations(before))
    own = turned[count, count]
    heads = before[:, :3, 3]
    nailed = after[count, count, :3, 3][:, None] + np.einsum("dij,dcj->dci", own, heads[None] - heads[:, None])
    shifted = np.linalg.norm(after[:, :, :3, 3] - heads, axis=-1)
    goes, stays = _angle(np.swapaxes(own, -1, -2)[:, None] @ turned) < _ALIKE_TURN, _angle(turned) < _ALIKE_TURN
    reach = size * _ALIKE_SHIFT * np.linalg.norm(_PROBE_SHIFT)
    near = np.linalg.norm(after[:, :, :3, 3] - nailed, axis=-1) < np.maximum(reach, _ALIKE_SHIFT * shifted)
    along = near & (shifted > reach)
    held = _angle(own) < _ALIKE_TURN
    goes[held] = along[held] = False
    np.fill_diagonal(goes, False)
    np.fill_diagonal(along, False)
    partly = ~goes & ~stays & ~held[:, None]
    np.fill_diagonal(partly, False)
    rank = np.lexsort((-goes.sum(1) - along.sum(1), goes.sum(0) + along.sum(0)))
    goes_in, along_in = goes[rank][:, rank], along[rank][:, rank]
    # Rotating the chest does not move a shoulder that begins at the chest's head. If two controls move in the same way,
    # the one that rotates along with more controls is lower in the tree.
    depth = along_in.sum(0) + goes_in.sum(0) / (1.0 + len(names))
    turns, moves = _deepest(goes_in, goes_in.sum(0)), _deepest(along_in, depth)
    unmoved = np.linalg.norm(after[count, count, :3, 3] - heads, axis=1) < reach
    listed = [tuple(names[i] for i in np.flatnonzero(mask)) for mask in (held, unmoved, partly.any(0))]
    return Hanging(tuple(names[i] for i in rank), before[rank], turns, moves, *listed)


def _deepest(carries: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """Return the deepest control (N,) that moves each control, or -1. ``carries[d, c]`` is true if d moves c."""
    likely = np.where(carries, 1 + depth[:, None], 0)
    return np.where(carries.any(0), likely.argmax(0), -1)


def bone_rotations(matrices: np.ndarray) -> np.ndarray:
    """Return the rotations (..., 3, 3) of bone matrices (..., 4, 4), without their scale."""
    R = matrices[..., :3, :3]
    return R / np.maximum(np.linalg.norm(R, axis=-2, keepdims=True), 1e-12)


def _angle(R: np.ndarray) -> np.ndarray:
    return np.arccos(np.clip((np.trace(R, axis1=-2, axis2=-1) - 1) / 2, -1.0, 1.0))
