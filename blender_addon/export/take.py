"""What is exported: an armature, the meshes it deforms, and a range of frames."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import bpy

from ..animation.curves import current_action
from ..conventions.timing import scene_frame_rate
from ..errors import NothingToExport


@dataclass(frozen=True)
class ExportTake:
    """A take in a scene."""

    name: str
    """Name of the armature."""
    scene: bpy.types.Scene
    """Scene whose frame rate counts."""
    armature: bpy.types.Object
    meshes: tuple[bpy.types.Object, ...]
    """Objects that the armature deforms."""
    frame_start: int
    """First scene frame."""
    frame_end: int
    """Last scene frame."""

    @property
    def fps(self) -> float:
        """Frames per second."""
        return scene_frame_rate(self.scene)

    @property
    def num_frames(self) -> int:
        """Number of frames."""
        return self.frame_end - self.frame_start + 1


def take_of(scene: bpy.types.Scene, obj: bpy.types.Object | None, frames: tuple[int, int] | None = None) -> ExportTake:
    """Return the take of an armature.

    Args:
        scene: scene the armature is in.
        obj: the armature, or a mesh it deforms.
        frames: first and last scene frame; None for those of the armature's action.

    Raises:
        NothingToExport: there is no armature, no motion, or no frame.
    """
    armature = _armature(obj)
    action = current_action(armature)
    if frames is None:
        if action is None:
            hint = "Give it one, or name a range of frames."
            raise NothingToExport("The armature has no current action.", where=armature.name, hint=hint)
        start, end = action.frame_range
        frames = math.floor(start + 1e-3), math.ceil(end - 1e-3)
    if frames[1] < frames[0]:
        raise NothingToExport(f"The frames {frames[0]} to {frames[1]} are none.", where=armature.name)
    meshes = (o for o in scene.objects if o.type == "MESH" and o.find_armature() is armature)
    return ExportTake(armature.name, scene, armature, tuple(meshes), *frames)


@contextmanager
def chosen(take: ExportTake) -> Iterator[bpy.types.Scene]:
    """Make a take the scene's only selection, and its frames the scene's range, while the block runs.

    Raises:
        NothingToExport: an object of the take is in a collection that is switched off.
    """
    scene = take.scene
    layer = bpy.context.view_layer
    layer.update()
    objects = (take.armature, *take.meshes)
    absent = [obj.name for obj in objects if obj.name not in layer.objects]
    if absent:
        raise NothingToExport(
            f"{', '.join(absent)} cannot be reached in this view layer.", hint="Switch its collection on."
        )
    selected, active = [obj for obj in layer.objects if obj.select_get()], layer.objects.active
    hidden = {obj: (obj.hide_viewport, obj.hide_get()) for obj in objects}
    frames = scene.frame_start, scene.frame_end, scene.frame_current, scene.frame_subframe
    try:
        for obj in selected:
            obj.select_set(False)
        for obj in objects:
            obj.hide_viewport = False
            obj.hide_set(False)
            obj.select_set(True)
        layer.objects.active = take.armature
        scene.frame_start, scene.frame_end = take.frame_start, take.frame_end
        yield scene
    finally:
        for obj in objects:
            obj.select_set(False)
            obj.hide_viewport = hidden[obj][0]
            obj.hide_set(hidden[obj][1])
        for obj in selected:
            obj.select_set(True)
        layer.objects.active = active
        scene.frame_start, scene.frame_end = frames[:2]
        scene.frame_set(frames[2], subframe=frames[3])


@contextmanager
def staged(take: ExportTake) -> Iterator[tuple[bpy.types.Scene, bpy.types.Depsgraph]]:
    """Put the armature alone into a scene of its own while the block runs, so that frames pass without its meshes."""
    stage = bpy.data.scenes.new(take.name)
    stage.render.fps, stage.render.fps_base = take.scene.render.fps, take.scene.render.fps_base
    stage.collection.objects.link(take.armature)
    try:
        with bpy.context.temp_override(scene=stage, view_layer=stage.view_layers[0]):
            yield stage, bpy.context.evaluated_depsgraph_get()
    finally:
        bpy.data.scenes.remove(stage)


def _armature(obj: bpy.types.Object | None) -> bpy.types.Object:
    if obj is not None and obj.type == "MESH":
        obj = obj.find_armature()
    if obj is None or obj.type != "ARMATURE":
        raise NothingToExport("No armature is chosen.", hint="Select the body of a take.")
    return obj
