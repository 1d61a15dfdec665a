"""Switch limbs between FK and IK. The keys change, but the motion does not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import bpy
import numpy as np

from .._exchange.errors import BodyInvalid
from .._exchange.progress import Progress, silent
from .._exchange.so3 import quat_from_matrix, sign_continuous
from ..animation.curves import (
    CurveTarget,
    current_action,
    curve_target,
    is_take,
    key_points,
    key_type_values,
    laid_rate,
    played_target,
    remove_curves,
    write_curves,
)
from ..body.controls.limbs import ROOT, Limb, has_limbs, limb_paths, show_limb, switch_path
from .session import sample_poses

_SAME = 1e-3  # Two keys closer than this, in scene frames, are on the same frame.


@dataclass(frozen=True)
class Channels:
    """Writes the locations, rotations and IK switches of an armature, as keys of an action or as the current pose."""

    armature: bpy.types.Object
    target: CurveTarget | None  # Curves of the action that is played, or None to set the pose.
    times: np.ndarray | None  # (F,) scene frames in the action, or None to set the pose.

    def set_location(self, bone: str, values: np.ndarray) -> None:
        """Key or set a bone's location (F, 3)."""
        self._put(bone, "location", values)

    def set_rotation(self, bone: str, R: np.ndarray) -> None:
        """Key or set a bone's rotation (F, 3, 3), as quaternions with continuous signs."""
        self._put(bone, "rotation_quaternion", sign_continuous(quat_from_matrix(R)[:, None])[:, 0])

    def set_switch(self, limb: Limb, value: float) -> None:
        """Key or set a limb's switch to the same value in every frame."""
        self.armature.pose.bones[ROOT][limb.switch] = value
        if self.target is not None and self.times is not None:
            remove_curves(self.target, switch_path(limb))
            types = key_type_values(None, 1)
            write_curves(self.target, switch_path(limb), ROOT, self.times[:1], np.full((1, 1), value), types)
        self.armature.update_tag()

    def _put(self, bone: str, prop: str, values: np.ndarray) -> None:
        setattr(self.armature.pose.bones[bone], prop, values[0].tolist())
        if self.target is None or self.times is None:
            return
        path = f'pose.bones["{bone}"].{prop}'
        old = remove_curves(self.target, path)
        types = key_type_values(None, len(self.times))
        if old is not None and len(old) == len(self.times) and np.abs(old[:, 0] - self.times).max() < _SAME:
            types = old[:, 1].astype(np.int32)
        write_curves(self.target, path, bone, self.times, values, types)


def channels_of(armature: bpy.types.Object) -> Channels:
    """Return the channels of an armature's current action, or of its pose if it plays no action.

    Raises ``BodyInvalid`` if the action cannot be edited, for instance because it is linked.
    """
    action = current_action(armature)
    if action is None:
        return Channels(armature, None, None)
    target = played_target(armature)
    if target is None:
        hint = "Make the action local (Object > Relations > Make Local), or show a take of this file."
        raise BodyInvalid("The current action of the body cannot be changed.", where=action.name, hint=hint)
    return Channels(armature, target, frames_of(action))


def frames_of(action: bpy.types.Action) -> np.ndarray:
    """Return the (F,) scene frames of a take's frames. For any other action, return the whole frames in its range."""
    first, last = action.frame_range
    step = laid_rate(action) / float(action["fps"]) if is_take(action) else 1.0
    step = 1.0 if abs(step - 1) < 1e-6 else step
    return first + step * np.arange(1 + int(np.floor((last - first) / step + 0.01)))


_STRAIGHT_M = 0.02  # If a joint is this close to the line between its neighbours, its pole follows the bone above.


def pole_places(upper: np.ndarray, lower: np.ndarray, end: np.ndarray, ahead: np.ndarray) -> np.ndarray:
    """Return (F, 3) pole positions in front of a limb's middle joint.

    The direction is ``o + s a``. o is the offset of the middle joint from the line between its neighbours, a is the
    forward direction of the bone above it, and s is a few centimetres. o and a are perpendicular to that line. The
    direction is smooth even if the limb is straight and o vanishes.

    Args:
        upper: (F, 3) positions of shoulders or hips in metres.
        lower: (F, 3) positions of elbows or knees.
        end: (F, 3) positions of wrists or ankles.
        ahead: (F, 3) unit vectors of the middle joint's bending direction, taken from the bone above it.
    """
    line = _unit(end - upper)
    way = _across(lower - upper, line) + _STRAIGHT_M * _across(ahead, line)
    length = np.linalg.norm(lower - upper, axis=-1, keepdims=True)
    return lower + length * _unit(np.where(np.linalg.norm(way, axis=-1, keepdims=True) > 1e-9, way, ahead))


def _across(v: np.ndarray, line: np.ndarray) -> np.ndarray:
    return v - (v * line).sum(-1, keepdims=True) * line


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-12)


def sample_bones(
    armature: bpy.types.Object,
    scene: bpy.types.Scene,
    names: Sequence[str],
    times: np.ndarray | None,
    progress: Progress = silent,
    stage: str = "Reading poses",
) -> dict[str, np.ndarray]:
    """Return the evaluated matrices (F, 4, 4) of each bone, at given scene frames or in the current frame."""
    if times is None:
        bpy.context.view_layer.update()
        bones = armature.evaluated_get(bpy.context.evaluated_depsgraph_get()).pose.bones
        return {name: np.array(bones[name].matrix, np.float64)[None] for name in names}
    _, poses = sample_poses(armature, scene, names, times, lambda f: progress(stage, f + 1, len(times)))
    return {name: poses[:, k] for k, name in enumerate(names)}


def own_channels(armature: bpy.types.Object, name: str, pose: np.ndarray, parent_pose: np.ndarray) -> np.ndarray:
    """Return a bone's (F, 4, 4) local transforms ``B = L^-1 L_p P_p^-1 P``, where L is at rest and P is posed."""
    bone = armature.data.bones[name]
    rest, above = (np.array(b.matrix_local, np.float64) for b in (bone, bone.parent))
    return np.linalg.inv(rest) @ above @ np.linalg.inv(parent_pose) @ pose


_LOCAL_AHEAD = {"arm": -1.0, "leg": 1.0}
"""Sign of the direction of elbows and knees, along Z of the bone above them (``layout.lay_out_bones``)."""


def pose_from_ends(
    armature: bpy.types.Object,
    scene: bpy.types.Scene,
    limbs: Sequence[Limb],
    times: np.ndarray | None = None,
    progress: Progress = silent,
) -> int:
    """Switch limbs to IK with keys that keep the motion, and return the number of frames.

    ``times`` are the scene frames to key (None for all). IK alone does not reproduce the joints' rotations, so keys on
    the turn bones add the difference. Raises ``BodyInvalid`` if the IK controls are missing or the action is linked.
    """
    channels = _channels(armature)
    channels = channels if times is None else replace(channels, times=times)
    joints = [joint for limb in limbs for joint in limb.joints]
    before = sample_bones(armature, scene, [ROOT, *joints], channels.times, progress)
    for limb in limbs:
        upper, lower, end = (before[joint] for joint in limb.joints)
        control = own_channels(armature, limb.control, end, before[ROOT])
        channels.set_location(limb.control, control[:, :3, 3])
        channels.set_rotation(limb.control, control[:, :3, :3])
        ahead = _LOCAL_AHEAD[limb.kind] * upper[:, :3, 2]
        pole = np.tile(np.array(armature.data.bones[limb.pole].matrix_local, np.float64), (len(upper), 1, 1))
        pole[:, :3, 3] = pole_places(upper[:, :3, 3], lower[:, :3, 3], end[:, :3, 3], ahead)
        channels.set_location(limb.pole, own_channels(armature, limb.pole, pole, before[ROOT])[:, :3, 3])
        channels.set_switch(limb, 1.0)
    names = [name for limb in limbs for name in limb.solved]
    solved = sample_bones(armature, scene, names, channels.times, progress, "Turning limbs")
    for limb in limbs:
        for turn, led, by in zip(limb.turns, limb.joints[:2], limb.solved, strict=True):
            R = own_channels(armature, turn, before[led], solved[by])
            channels.set_rotation(turn, R[:, :3, :3])
        show_limb(armature, limb, from_end=True)
    return _done(channels)


def pose_by_joints(
    armature: bpy.types.Object, scene: bpy.types.Scene, limbs: Sequence[Limb], progress: Progress = silent
) -> int:
    """Key the joints so that limbs keep their motion, then switch to FK and show the joints."""
    channels = _channels(armature)
    bones = armature.data.bones
    wanted = {name for limb in limbs for joint in limb.joints for name in (joint, bones[joint].parent.name)}
    before = sample_bones(armature, scene, sorted(wanted), channels.times, progress)
    for limb in limbs:
        for joint in limb.joints:
            local = own_channels(armature, joint, before[joint], before[bones[joint].parent.name])
            channels.set_rotation(joint, local[:, :3, :3])
        channels.set_switch(limb, 0.0)
        show_limb(armature, limb, from_end=False)
    return _done(channels)


def switch_limbs(
    armature: bpy.types.Object, scene: bpy.types.Scene, to: str, limbs: Sequence[Limb], progress: Progress = silent
) -> int:
    """Switch limbs to ``IK`` or ``FK``. See ``pose_from_ends``."""
    if to == "IK":
        return pose_from_ends(armature, scene, limbs, progress=progress)
    return pose_by_joints(armature, scene, limbs, progress)


def take_switched(
    armature: bpy.types.Object, take: bpy.types.Action, switched: bpy.types.Action, to: str, limbs: Sequence[Limb]
) -> None:
    """Move the limbs' keys into a take from its copy ``switched``, and update the body if it plays the take."""
    source, target = curve_target(switched), curve_target(take)
    assert source is not None and target is not None, "a take has a slot"
    for limb in limbs:
        joints = {f'pose.bones["{joint}"].rotation_quaternion' for joint in limb.joints}
        for path in (*sorted(limb_paths(limb) if to == "IK" else joints), switch_path(limb)):
            values = [key_points(curve)[:, 1] for curve in source.container.fcurves if curve.data_path == path]
            keys = remove_curves(source, path)
            if keys is not None:
                remove_curves(target, path)
                write_curves(
                    target, path, path.split('"')[1], keys[:, 0], np.stack(values, 1), keys[:, 1].astype(np.int32)
                )
        if current_action(armature) == take:
            armature.pose.bones[ROOT][limb.switch] = float(to == "IK")
            show_limb(armature, limb, from_end=to == "IK")
    armature.update_tag()


def _channels(armature: bpy.types.Object) -> Channels:
    if not has_limbs(armature):
        message = "This body has no controls for hands and feet, because they were deleted."
        hint = "Import its motion file again (File > Import) to create a body with these controls."
        raise BodyInvalid(message, where=getattr(armature, "name", ""), hint=hint)
    return channels_of(armature)


def _done(channels: Channels) -> int:
    bpy.context.view_layer.update()
    return 0 if channels.times is None else len(channels.times)
