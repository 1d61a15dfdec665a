"""Retarget an actor's motion to another rig, and check the result in Blender."""

from __future__ import annotations

import json
from dataclasses import dataclass, field

import bpy
import numpy as np

from .._exchange.rigs.skeleton import HELPER_OF, LIMBS
from .._exchange.so3 import quat_from_matrix, rotvec_from_quat, sign_continuous
from ..animation.curves import create_action, key_type_values, write_curves
from ..animation.takes import push_down
from ..conventions.coordinates import euler_from_matrix
from ..conventions.timing import TakeTiming
from ..errors import TargetUnsuitable
from ..scene.session import alone
from .hanging import neutral
from .motion.figures import Actor, Target
from .motion.map_pose import (
    LEANS_DEG,
    Proportions,
    lean_at_rest_deg,
    map_pose,
    map_pose_values,
    measure_proportions,
)
from .motion.transfer import Transferred, TransferSettings, transfer
from .rig_map import RigMap, map_values
from .target_rig import TargetRig, read_target


@dataclass(frozen=True)
class Channel:
    """Values of one animated property of a rig's control."""

    bone: str
    prop: str  # ``location`` or a rotation.
    values: np.ndarray  # (F, n) values, one column per component.


def channels_of(done: Transferred, target: Target, modes: dict[str, str]) -> list[Channel]:
    """Return the channels to key: rotations, and the locations of the carrier, the root and IK controls.

    A rotation channel is ``r^T D_with^T D r``, where r are the control's rest axes, D is its rotation, and D_with is
    the rotation of the control that rotates it. A location channel is ``l^T D_with^T (p - p_carried)``, where l are the
    axes of the channel, p is the control's position and p_carried is its position without the channel. ``modes`` are
    the rotation modes.
    """
    channels, r = [], target.axes[:, None]
    undone = np.where((target.turns_with < 0)[:, None, None, None], np.eye(3), done.turns[target.turns_with])
    undone = undone.swapaxes(-1, -2)
    basis = r.swapaxes(-1, -2) @ undone @ done.turns @ r
    quat = sign_continuous(np.moveaxis(quat_from_matrix(basis), 0, 1))
    for c, (name, role) in enumerate(zip(target.names, target.roles, strict=True)):
        part = role.partition("_")[2]
        if (part in HELPER_OF and part != "toe_ik") or c == done.carrier or role == "root":
            m, carried = target.moves_with[c], target.heads[c]
            if m >= 0:
                carried = done.places[m] + (done.turns[m] @ (target.heads[c] - target.heads[m]))
            way = target.place_axes[c].T @ undone[c] @ (done.places[c] - carried)[..., None]
            channels.append(Channel(name, "location", way[..., 0] / target.unit_m))
        if not part.endswith("pole"):
            channels.append(_rotation(name, modes[name], basis[c], quat[:, c]))
    return channels


def _rotation(bone: str, mode: str, R: np.ndarray, quat: np.ndarray) -> Channel:
    if mode == "QUATERNION":
        return Channel(bone, "rotation_quaternion", quat)
    if mode == "AXIS_ANGLE":
        rotvec = rotvec_from_quat(quat)
        angle = np.linalg.norm(rotvec, axis=-1, keepdims=True)
        axis = np.where(angle > 1e-9, rotvec / np.maximum(angle, 1e-9), np.array([0.0, 1.0, 0.0]))
        return Channel(bone, "rotation_axis_angle", np.concatenate([angle, axis], axis=1))
    return Channel(bone, "rotation_euler", euler_from_matrix(R, mode))


_CHECKED_FRAMES = 6
_REFUSED_MM = 100.0
"""Deviation of hands and feet in millimetres, at the actor's size, above which a rig is rejected."""
_SAME_PLACE = 0.002  # A bone is at a control's position if it is closer than this fraction of the rig's size.


def measure_deviation_mm(rig: TargetRig, scene: bpy.types.Scene, done: Transferred, channels: list[Channel]) -> float:
    """Return the largest distance in mm between a hand or foot on the rig and its planned position.

    Raises ``TargetUnsuitable`` if the distance is large. ``Transferred.missed_m`` is the distance between plan and
    goal.
    """
    ends = {roles[-1]: rig.target.index(roles[-1]) for roles in LIMBS.values() if roles[-1] in done.goals}
    names = [_shown_bone(rig, end) for end in ends.values()]
    frames = np.unique(np.linspace(0, done.places.shape[1] - 1, _CHECKED_FRAMES).round().astype(int))
    worst = 0.0
    with neutral(rig.armature, rig.target.names, rig.switches), alone(rig.armature, scene) as (stage, depsgraph):
        for f in frames if ends else ():
            for channel in channels:
                setattr(rig.armature.pose.bones[channel.bone], channel.prop, channel.values[f].tolist())
            stage.view_layers[0].update()
            bones = rig.armature.evaluated_get(depsgraph).pose.bones
            heads = _on_stage(rig.target, np.array([bones[name].head for name in names], np.float64))
            wanted = done.places[list(ends.values()), f]
            worst = max(worst, 1000.0 * float(np.linalg.norm(heads - wanted, axis=1).max()))
    if worst > _REFUSED_MM * done.scale:
        message = f"Hands or feet would be up to {worst / 1000:.2f} m from their planned positions."
        hint = "Mute constraints and drivers that move the limbs, or correct the bone map."
        raise TargetUnsuitable(message, where=rig.armature.name, hint=hint)
    return worst


def _on_stage(target: Target, points: np.ndarray) -> np.ndarray:
    return target.unit_m * points @ target.R_stage_armature.T - target.ground


def _shown_bone(rig: TargetRig, control: int) -> str:
    """Return the deforming bone at a control's rest position, or else the control itself."""
    name, bones = rig.target.names[control], rig.armature.data.bones
    if bones[name].use_deform:
        return name
    near = _SAME_PLACE * float(np.ptp(rig.target.heads, axis=0).max()) / rig.target.unit_m
    place = bones[name].head_local
    return next((b.name for b in bones if b.use_deform and (b.head_local - place).length < near), name)


_TOLERATED_MM = 10.0  # Deviation of hands and feet in mm, at the actor's size, above which a note is added.
MAP = "retarget_map"  # Custom property of a retargeted action: the map, as text.


@dataclass(frozen=True)
class RetargetSettings:
    """Settings for retargeting a motion to a rig."""

    limbs: str = "fk"  # ``fk`` or ``ik``, for the switches of the rig. The controls of both are keyed.
    transfer: TransferSettings = field(default_factory=TransferSettings)


@dataclass(frozen=True)
class Retargeted:
    """Result of a retarget: the new action, and figures about its accuracy."""

    action: bpy.types.Action
    rig_map: RigMap  # The map, including its map pose.
    scale: float
    """Size of the rig's path relative to the actor's path. By default it is the ratio of the leg lengths."""
    proportions: Proportions  # Proportions from which the scale was derived.
    soles: str  # How the sole height was found: ``mesh`` or ``joints``.
    deviation_mm: float  # Largest distance between a hand or foot and its planned position, in a few checked frames.
    notes: tuple[str, ...]


def retarget(
    actor: Actor,
    armature: bpy.types.Object,
    scene: bpy.types.Scene,
    rig_map: RigMap,
    timing: TakeTiming,
    settings: RetargetSettings = RetargetSettings(),
) -> Retargeted:
    """Transfer an actor's motion to a rig as a new action, and move the rig's own action to a muted NLA track."""
    fingers = {role for hand in actor.hands for role in hand.roles}
    rig = read_target(armature, scene, rig_map, settings.limbs, fingers)
    A = map_pose(rig.target, actor.rest, rig_map.map_pose)
    used = RigMap(rig_map.label, rig_map.bones, rig_map.switches, map_pose_values(rig.target, A))
    done = transfer(actor, rig.target, A, settings.transfer)
    channels = channels_of(done, rig.target, rig.modes)
    deviation_mm = measure_deviation_mm(rig, scene, done, channels)
    action = _bake_channels(f"{actor.name} on {armature.name}", rig, channels, timing, actor.fps)
    action[MAP] = json.dumps(map_values(used))
    notes = [*rig_map.doubts, *rig.notes]
    if settings.transfer.root_motion and not settings.transfer.in_place and rig.target.index("root") < 0:
        notes.append("The rig has no root bone, so the hips carry the travel.")
    if deviation_mm > _TOLERATED_MM * max(done.scale, 1.0):
        off = f"Hands or feet are up to {deviation_mm / 1000:.3f} m from their planned positions"
        notes.append(f"{off}. Constraints, drivers or limits of the rig move them.")
    tolerated_m = _TOLERATED_MM / 1000 * max(done.scale, 1.0)
    if done.beyond_m > tolerated_m:
        notes.append(f"A hand contact is {done.beyond_m:.2f} m out of reach of the rig's arm. The hand stops short.")
    if (missed := done.missed_m(rig.target)) > tolerated_m:
        notes.append(f"The rig's limbs cannot follow the motion. Hands or feet are up to {missed:.2f} m off.")
    if not rig_map.map_pose and (lean := lean_at_rest_deg(rig.target)) > LEANS_DEG:
        hint = "pose the rig upright and use Pose > Apply > Apply Pose as Rest Pose on rig and skin"
        turned = f"The rig's trunk leans {lean:.0f}° at rest and was turned upright for the retarget."
        notes.append(f"{turned} If trunk or head look wrong, {hint}.")
    proportions = measure_proportions(actor, rig.target)
    return Retargeted(action, used, done.scale, proportions, rig.soles, deviation_mm, tuple(notes))


def _bake_channels(
    name: str, rig: TargetRig, channels: list[Channel], timing: TakeTiming, fps: float
) -> bpy.types.Action:
    """Write a rig's channels as a new action and play it. The previous action is muted."""
    try:
        push_down(rig.armature)
        target = create_action(name, rig.armature)
    except (RuntimeError, AttributeError, TypeError) as error:
        hint = "Make its library override editable, or a local copy."
        raise TargetUnsuitable(f"The rig cannot be animated ({error}).", where=rig.armature.name, hint=hint) from error
    frames = len(channels[0].values)
    times, types = timing.scene_frames(frames, fps), key_type_values(None, frames)
    for channel in channels:
        path = f'pose.bones["{bpy.utils.escape_identifier(channel.bone)}"].{channel.prop}'
        write_curves(target, path, channel.bone, times, channel.values, types)
    for (bone, key), value in rig.switches.items():
        quoted = f'pose.bones["{bpy.utils.escape_identifier(bone)}"]["{bpy.utils.escape_identifier(key)}"]'
        write_curves(target, quoted, bone, times[:1], np.full((1, 1), value), types[:1])
    target.action.use_fake_user = True
    return target.action
