"""The check before anything is written: a rig posed on a few frames, hands and feet compared with their goals."""

from __future__ import annotations

import bpy
import numpy as np

from .._exchange.rigs.roles import LIMBS
from ..errors import TargetUnsuitable
from ..scene.alone import alone
from .channels import Channel
from .hanging import neutral
from .motion.figures import Target
from .motion.transfer import Transferred
from .target_rig import TargetRig

_CHECKED_FRAMES = 6
_REFUSED_MM = 100.0
"""Deviation of hands and feet, at the actor's size, from which a rig is refused."""
_SAME_PLACE = 0.002
"""Share of the rig's size within which a skinned bone stands where a control does."""


def deviation_m(
    rig: TargetRig,
    scene: bpy.types.Scene,
    done: Transferred,
    channels: list[Channel],
    switches: dict[tuple[str, str], float],
) -> float:
    """Return the largest distance of a hand or foot from its goal on a few frames; afterwards the rig is as it was.

    Args:
        rig: the rig.
        scene: the scene it is in.
        done: the motion, with the goals.
        channels: what would be keyed.
        switches: value of each custom property (bone, key).

    Raises:
        TargetUnsuitable: the rig cannot be posed.
    """
    ends = {roles[-1]: rig.target.index(roles[-1]) for roles in LIMBS.values() if roles[-1] in done.goals}
    if not ends:
        return 0.0
    names = [_shown_bone(rig, end) for end in ends.values()]
    frames = np.unique(np.linspace(0, done.places.shape[1] - 1, _CHECKED_FRAMES).round().astype(int))
    worst = 0.0
    with neutral(rig.armature, rig.target.names, switches), alone(rig.armature, scene) as (stage, depsgraph):
        for f in frames:
            for channel in channels:
                setattr(rig.armature.pose.bones[channel.bone], channel.prop, channel.values[f].tolist())
            stage.view_layers[0].update()
            bones = rig.armature.evaluated_get(depsgraph).pose.bones
            heads = on_stage(rig.target, np.array([bones[name].head for name in names], np.float64))
            wanted = np.array([done.goals[role][f] for role in ends])
            worst = max(worst, float(np.linalg.norm(heads - wanted, axis=1).max()))
    return worst


def require_near(deviation_mm: float, scale: float, name: str) -> None:
    """Check that hands and feet of a rig come near where they belong.

    Raises:
        TargetUnsuitable: they do not.
    """
    if deviation_mm > _REFUSED_MM * scale:
        raise TargetUnsuitable(
            f"Hands or feet would be up to {deviation_mm:.0f} mm from where they belong.", where=name,
            hint="Mute constraints and drivers that move the limbs, or correct the map of the bones.",
        )  # fmt: skip


def on_stage(target: Target, points: np.ndarray) -> np.ndarray:
    """Return points (..., 3) of the armature's space on the target's stage."""
    return target.unit_m * points @ target.R_stage_armature.T - target.ground


def _shown_bone(rig: TargetRig, control: int) -> str:
    """Return the bone that carries the skin where a control stands at rest, else the control itself."""
    name, bones = rig.target.names[control], rig.armature.data.bones
    if bones[name].use_deform:
        return name
    near = _SAME_PLACE * float(np.ptp(rig.target.heads, axis=0).max()) / rig.target.unit_m
    place = bones[name].head_local
    return next((b.name for b in bones if b.use_deform and (b.head_local - place).length < near), name)
