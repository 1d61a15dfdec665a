"""Channels put into an action over its frames, or into a pose that nothing plays."""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np

from ..._exchange.errors import BodyInvalid
from ..._exchange.so3 import quat_from_matrix, sign_continuous
from ...animation.curves import CurveTarget, current_action, key_type_values, played_target, remove_curves, write_curves
from ...animation.retiming import is_take, laid_rate
from ...body.controls.limbs import ROOT, Limb, switch_path

_SAME = 1e-3
"""Scene frames within which two keys lie on one."""


@dataclass(frozen=True)
class Channels:
    """Where the channels of an armature go."""

    armature: bpy.types.Object
    target: CurveTarget | None
    """The action it plays; None for the pose it stands in."""
    times: np.ndarray | None
    """(F,) scene frames of the action; None for the pose."""

    def set_location(self, bone: str, values: np.ndarray) -> None:
        """Key or set a bone's (F, 3) location."""
        self._put(bone, "location", values)

    def set_rotation(self, bone: str, R: np.ndarray) -> None:
        """Key or set a bone's (F, 3, 3) rotation, as quaternions that are continuous in sign."""
        self._put(bone, "rotation_quaternion", sign_continuous(quat_from_matrix(R)[:, None])[:, 0])

    def set_switch(self, limb: Limb, value: float) -> None:
        """Key or set a limb's switch, one value throughout."""
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
    """Return where an armature's channels go: into the action it plays or, without one, into its pose.

    Raises:
        BodyInvalid: its action is linked from another file.
    """
    action = current_action(armature)
    if action is None:
        return Channels(armature, None, None)
    target = played_target(armature)
    if target is None:
        hint = "Make the action local (Object > Relations > Make Local), or show a take of this file."
        raise BodyInvalid("The action that the body plays cannot be changed.", where=action.name, hint=hint)
    return Channels(armature, target, frames_of(action))


def frames_of(action: bpy.types.Action) -> np.ndarray:
    """Return the (F,) scene frames of an action: those of a take as they are laid, otherwise every whole one."""
    first, last = action.frame_range
    step = laid_rate(action) / float(action["fps"]) if is_take(action) else 1.0
    step = 1.0 if abs(step - 1) < 1e-6 else step
    return first + step * np.arange(1 + int(np.floor((last - first) / step + 0.01)))
