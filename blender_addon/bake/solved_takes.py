"""Takes of one body: each solve is a new action, and earlier ones stay."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import bpy
import numpy as np

from ..files.body_file import BodyFile
from ..files.motion_file import MotionFile
from .action import bake_action
from .scene import BakeSettings, bake_take, require_body
from .timing import TakeTiming, scene_frame_rate

BETAS = "betas"
"""Custom property of armatures and actions: the shape the bones stand in."""
_SAME_SHAPE = 1e-3


@dataclass(frozen=True)
class Provenance:
    """The files a take came from and went to."""

    motion: Path
    capture: Path
    report: Path | None
    job: Path

    def write(self, action: bpy.types.Action) -> None:
        """Keep the paths as custom properties of the action."""
        action["motion_file"], action["capture_file"] = str(self.motion), str(self.capture)
        action["report_file"] = str(self.report) if self.report is not None else ""
        action["job_file"] = str(self.job)


def add_take(
    scene: bpy.types.Scene,
    name: str,
    motion: MotionFile,
    body: BodyFile,
    armature: bpy.types.Object | None,
    parent: bpy.types.Collection | None,
    frame_start: int,
) -> tuple[bpy.types.Object, bpy.types.Action]:
    """Add a solved motion as a new action, to the armature that is there or with a new body.

    Args:
        scene: the scene; its frame rate stays.
        name: name of the take.
        motion: the motion.
        body: the body it was solved for.
        armature: the body of earlier takes, None if there is none; used if it has the motion's shape.
        parent: collection a new body goes into, None for the scene's.
        frame_start: scene frame of the first frame.

    Returns:
        The armature and the action, which is now its current one.

    Raises:
        BodyMismatch: the motion belongs to another body.
    """
    require_body(motion, body)
    if armature is not None and has_shape(armature, motion.betas):
        timing = TakeTiming(frame_start, scene_frame_rate(scene))
        action = bake_action(name, motion, armature, body.rest_joints(motion.betas)[0], timing)
        action[BETAS] = motion.betas.tolist()
        scene.frame_set(scene.frame_current)
        return armature, action
    settings = BakeSettings(frame_start=frame_start, set_scene=False, floor=False)
    take = bake_take(scene, replace(motion, name=name), body, None, settings, parent)
    take.armature[BETAS] = take.action[BETAS] = motion.betas.tolist()
    return take.armature, take.action


def has_shape(armature: bpy.types.Object, betas: np.ndarray) -> bool:
    """Return whether an armature stands in a shape."""
    return BETAS in armature and bool(np.abs(np.array(armature[BETAS]) - betas).max() < _SAME_SHAPE)


def takes_of(armature: bpy.types.Object) -> list[bpy.types.Action]:
    """Return the solved actions that fit an armature's shape, by name."""
    return [action for action in bpy.data.actions if BETAS in action and has_shape(armature, np.array(action[BETAS]))]


def show_take(armature: bpy.types.Object, action: bpy.types.Action) -> None:
    """Make an action the armature's current one, with its slot where there are slots."""
    animation = armature.animation_data or armature.animation_data_create()
    animation.action = action
    if hasattr(action, "slots") and len(action.slots):
        animation.action_slot = action.slots[0]
