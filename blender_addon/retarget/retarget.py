"""The retarget as one verb: an actor's motion on another rig, checked in Blender."""

from __future__ import annotations

import json
from dataclasses import dataclass, field

import bpy
import numpy as np

from ..animation.curves import create_action, key_type_values, write_curves
from ..animation.takes import push_down
from ..conventions.timing import TakeTiming
from ..errors import TargetUnsuitable
from .channels import Channel, channels_of
from .check import deviation_m, require_near
from .maps.rig_map import RigMap, map_values
from .motion.figures import Actor
from .motion.map_pose import map_pose, map_pose_values
from .motion.proportions import Proportions, measure_proportions
from .motion.transfer import TransferSettings, transfer
from .target_rig import read_target

_TOLERATED_MM = 10.0
"""Deviation of hands and feet, at the actor's size, from which the result carries a note."""
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
    """Size of the rig's way by the actor's: the ratio of the legs between their joints, unless it was given."""
    proportions: Proportions
    """What the scale comes from."""
    soles: str
    """What shows the height of the rig's soles: ``mesh`` or ``joints``."""
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
        TargetUnsuitable: see ``read_target`` and ``scale_of``, or hands and feet do not come near where they belong.
        MapInvalid: see ``read_target``. Nothing is changed then.
    """
    fingers = {role for hand in actor.hands for role in hand.roles}
    rig = read_target(armature, scene, rig_map, settings.limbs, fingers)
    A = map_pose(rig.target, actor.rest, rig_map.map_pose)
    used = RigMap(rig_map.label, rig_map.bones, rig_map.switches, map_pose_values(rig.target, A))
    done = transfer(actor, rig.target, A, settings.transfer)
    modes = {name: armature.pose.bones[name].rotation_mode for name in rig.target.names}
    channels = channels_of(done, rig.target, modes)
    switches = {(s.bone, s.key): getattr(s, settings.limbs) for s in rig.switches}
    scale, name = done.scale, f"{actor.name} on {armature.name}"
    deviation_mm = 1000.0 * deviation_m(rig, scene, done, channels, switches)
    require_near(deviation_mm, scale, armature.name)
    action = bake_channels(name, armature, channels, switches, timing, actor.fps)
    action[MAP] = json.dumps(map_values(used))
    notes = [*rig_map.doubts, *rig.notes]
    if settings.transfer.root_motion and not settings.transfer.in_place and rig.target.index("root") < 0:
        notes.append("The rig has no root bone of its own: the hips carry the travel.")
    if deviation_mm > _TOLERATED_MM * max(scale, 1.0):
        notes.append(
            f"Hands or feet are up to {deviation_mm:.0f} mm from where they belong: "
            "constraints, drivers or limits of the rig move them."
        )
    proportions = measure_proportions(actor, rig.target)
    return Retargeted(action, used, scale, proportions, rig.soles, deviation_mm, tuple(notes))


def bake_channels(
    name: str,
    armature: bpy.types.Object,
    channels: list[Channel],
    switches: dict[tuple[str, str], float],
    timing: TakeTiming,
    fps: float,
) -> bpy.types.Action:
    """Write channels as a new action and play it; the action that the rig had waits on a muted NLA track.

    Args:
        name: name of the action.
        armature: the rig.
        channels: what is keyed on every frame.
        switches: value of each custom property (bone, key), keyed once.
        timing: where the motion lies in the scene.
        fps: frames per second of the motion.

    Raises:
        TargetUnsuitable: the rig's animation cannot be changed.
    """
    try:
        push_down(armature)
        target = create_action(name, armature)
    except (RuntimeError, AttributeError, TypeError) as error:
        hint = "Make its library override editable, or a local copy."
        raise TargetUnsuitable(f"The rig cannot be animated ({error}).", where=armature.name, hint=hint) from error
    frames = len(channels[0].values)
    times, types = timing.scene_frames(frames, fps), key_type_values(None, frames)
    for channel in channels:
        path = f'pose.bones["{bpy.utils.escape_identifier(channel.bone)}"].{channel.prop}'
        write_curves(target, path, channel.bone, times, channel.values, types)
    for (bone, key), value in switches.items():
        quoted = f'pose.bones["{bpy.utils.escape_identifier(bone)}"]["{bpy.utils.escape_identifier(key)}"]'
        write_curves(target, quoted, bone, times[:1], np.full((1, 1), value), types[:1])
    target.action.use_fake_user = True
    return target.action
