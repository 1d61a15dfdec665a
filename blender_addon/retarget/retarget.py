"""The retarget as one verb: an actor's motion on another rig, checked in Blender."""

from __future__ import annotations

import json
from dataclasses import dataclass, field

import bpy
import numpy as np

from ..conventions.timing import TakeTiming, go_to_frame
from ..scene.alone import alone
from .baking import bake_channels
from .channels import channels_of
from .maps.rig_map import RigMap, map_values
from .maps.roles import LIMBS
from .motion.figures import Actor, Target
from .motion.map_pose import map_pose, map_pose_values
from .motion.transfer import Transferred, TransferSettings, transfer
from .target_rig import TargetRig, read_target

_CHECKED_FRAMES = 6
_TOLERATED_MM = 10.0
MAP = "retarget_map"
"""Custom property of a retargeted action: the map that was used, as text."""


@dataclass(frozen=True)
class RetargetSettings:
    """How to retarget."""

    limbs: str = "fk"
    """``fk`` or ``ik``: which controls the rig's switches are set to; both are keyed."""
    transfer: TransferSettings = field(default_factory=TransferSettings)


@dataclass(frozen=True)
class Retargeted:
    """A motion on a rig."""

    action: bpy.types.Action
    rig_map: RigMap
    """The map that was used, its map pose filled in."""
    scale: float
    """Length of the rig's legs by the actor's."""
    deviation_mm: float
    """Largest distance of a hand or foot in Blender from where it belongs, on a few frames."""
    notes: tuple[str, ...]


def retarget(
    actor: Actor,
    armature: bpy.types.Object,
    scene: bpy.types.Scene,
    rig_map: RigMap,
    timing: TakeTiming,
    settings: RetargetSettings = RetargetSettings(),
) -> Retargeted:
    """Lay an actor's motion on a rig as a new action; what the rig played waits on a muted NLA track.

    Args:
        actor: the motion.
        armature: the rig; Blender must be in object or pose mode.
        scene: the scene it is in.
        rig_map: which of its bones plays which role.
        timing: where the motion lies in the scene.
        settings: how.

    Raises:
        TargetUnsuitable, MapInvalid: see ``read_target``; then nothing is changed.
    """
    rig = read_target(armature, scene, rig_map, settings.limbs)
    A = map_pose(rig.target, actor.rest, rig_map.map_pose)
    used = RigMap(rig_map.label, rig_map.bones, rig_map.switches, map_pose_values(rig.target, A))
    done = transfer(actor, rig.target, A, settings.transfer)
    modes = {name: armature.pose.bones[name].rotation_mode for name in rig.target.names}
    channels = channels_of(done, rig.target, modes)
    switches = {(s.bone, s.key): getattr(s, settings.limbs) for s in rig.switches}
    action = bake_channels(f"{actor.name} on {armature.name}", armature, channels, switches, timing, actor.fps)
    action[MAP] = json.dumps(map_values(used))
    times = timing.scene_frames(actor.num_frames, actor.fps)
    deviation_mm = _deviation_mm(rig, scene, done, times)
    notes = list(rig.notes)
    if deviation_mm > _TOLERATED_MM:
        notes.append(
            f"Hands or feet are up to {deviation_mm:.0f} mm from where they belong: "
            "constraints, drivers or limits of the rig move them."
        )
    return Retargeted(action, used, done.scale, deviation_mm, tuple(notes))


def _deviation_mm(rig: TargetRig, scene: bpy.types.Scene, done: Transferred, times: np.ndarray) -> float:
    ends = {roles[-1]: rig.target.index(roles[-1]) for roles in LIMBS.values() if roles[-1] in done.goals}
    names = [_shown_bone(rig, end) for end in ends.values()]
    frames = np.unique(np.linspace(0, len(times) - 1, _CHECKED_FRAMES).round().astype(int))
    worst = 0.0
    with alone(rig.armature, scene) as (stage, depsgraph):
        for f in frames if names else ():
            go_to_frame(stage, float(times[f]))
            bones = rig.armature.evaluated_get(depsgraph).pose.bones
            heads = on_stage(rig.target, np.array([bones[name].head for name in names], np.float64))
            wanted = np.array([done.goals[role][f] for role in ends])
            worst = max(worst, float(np.linalg.norm(heads - wanted, axis=1).max()))
    return 1000.0 * worst


def _shown_bone(rig: TargetRig, control: int) -> str:
    """Return the bone that carries the skin where a control stands at rest, else the control itself."""
    name, bones = rig.target.names[control], rig.armature.data.bones
    if bones[name].use_deform:
        return name
    place, near = bones[name].head_local, 0.05 * bones[name].length
    there = (bone for bone in bones if bone.use_deform and (bone.head_local - place).length < near)
    return next((bone.name for bone in there), name)


def on_stage(target: Target, points: np.ndarray) -> np.ndarray:
    """Return points (..., 3) of the armature's space on the target's stage."""
    return target.unit_m * points @ target.R_stage_armature.T - target.ground
