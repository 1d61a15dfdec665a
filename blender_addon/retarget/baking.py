"""The result in Blender: one new action of the rig, beside everything it had."""

from __future__ import annotations

import bpy
import numpy as np

from ..animation.curves import create_action, key_type_values, write_curves
from ..animation.takes import push_down
from ..conventions.timing import TakeTiming
from ..errors import TargetUnsuitable
from .channels import Channel


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
