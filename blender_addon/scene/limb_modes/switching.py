"""A limb's motion from FK to IK and back: what is seen stays, what is keyed changes."""

from __future__ import annotations

from collections.abc import Sequence

import bpy
import numpy as np

from ..._exchange.errors import BodyInvalid
from ...body.controls.limbs import ROOT, Limb, has_limbs, show_limb
from .channels import Channels, channels_of
from .poles import pole_places
from .samples import own_channels, sample_bones

_LOCAL_AHEAD = {"arm": -1.0, "leg": 1.0}
"""Where elbows and knees point along Z of the bone above them (``layout.lay_out_bones``)."""


def pose_from_ends(armature: bpy.types.Object, scene: bpy.types.Scene, limbs: Sequence[Limb]) -> int:
    """Key hands or feet, poles and turns so that limbs move as they do now, switch them to IK, show their ends alone.

    What IK finds for the poles is sampled, and the turns make up the difference: joints keep their rotations, and so
    their places, but for rounding.

    Args:
        armature: a body with limb controls.
        scene: the scene it is in.
        limbs: which.

    Returns:
        The number of frames keyed; 0 where the body plays nothing and only its pose was set.

    Raises:
        BodyInvalid: the body was made by a version without these controls, or plays a linked action.
    """
    channels = _channels(armature)
    joints = [joint for limb in limbs for joint in limb.joints]
    before = sample_bones(armature, scene, [ROOT, *joints], channels.times)
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
    solved = sample_bones(armature, scene, [name for limb in limbs for name in limb.solved], channels.times)
    for limb in limbs:
        for turn, led, by in zip(limb.turns, limb.joints[:2], limb.solved, strict=True):
            R = own_channels(armature, turn, before[led], solved[by])
            channels.set_rotation(turn, R[:, :3, :3])
        show_limb(armature, limb, from_end=True)
    return _done(channels)


def pose_by_joints(armature: bpy.types.Object, scene: bpy.types.Scene, limbs: Sequence[Limb]) -> int:
    """Key joints so that limbs move as they do now, switch them to FK, and show the joints alone.

    Args, return value and errors are those of ``pose_from_ends``.
    """
    channels = _channels(armature)
    bones = armature.data.bones
    wanted = {name for limb in limbs for joint in limb.joints for name in (joint, bones[joint].parent.name)}
    before = sample_bones(armature, scene, sorted(wanted), channels.times)
    for limb in limbs:
        for joint in limb.joints:
            local = own_channels(armature, joint, before[joint], before[bones[joint].parent.name])
            channels.set_rotation(joint, local[:, :3, :3])
        channels.set_switch(limb, 0.0)
        show_limb(armature, limb, from_end=False)
    return _done(channels)


def _channels(armature: bpy.types.Object) -> Channels:
    if not has_limbs(armature):
        raise BodyInvalid(
            "This body has no controls for hands and feet: a version before them made it, or they were deleted.",
            where=getattr(armature, "name", ""),
            hint="Import its motion file again (File > Import): that makes a body with them.",
        )
    return channels_of(armature)


def _done(channels: Channels) -> int:
    bpy.context.view_layer.update()
    return 0 if channels.times is None else len(channels.times)
