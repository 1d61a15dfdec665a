"""Describe a take to export (an armature, its meshes and a frame range), and sample its poses."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import bpy
import numpy as np

from .._exchange.diagnostics import Diagnostic
from .._exchange.progress import Progress
from ..animation.curves import current_action, is_take, laid_rate, same_rate
from ..animation.takes import warnings_of_take
from ..conventions.coordinates import even_scale
from ..conventions.skeleton import layout_of
from ..conventions.timing import scene_frame_rate, set_scene_frame_rate
from ..errors import NothingToExport
from ..scene.session import sample_poses
from .formats import AS_RECORDED, FileLayout

_WHOLE = 1e-3  # Largest difference in frames, and largest relative difference in rates, that is ignored.
_SAME_SIZE = 1e-4  # Relative difference between scales that is ignored.
_SLACK = 0.01  # Tolerance for the position of keys in frames, because Blender uses single precision. Chosen by hand.


@dataclass(frozen=True)
class ExportTake:
    """A take to export: an armature, its meshes and a range of frames in a scene."""

    name: str  # Name of the armature.
    scene: bpy.types.Scene  # Scene that defines the frame rate.
    armature: bpy.types.Object
    meshes: tuple[bpy.types.Object, ...]  # Objects that the armature deforms.
    first: float  # Scene frame at which the take begins.
    num_frames: int  # Number of frames.
    fps: float  # Frames per second.
    step: float = 1.0  # Scene frames between two frames of the take.
    is_plain: bool = False  # True for an export copy that is in the file's unit and has a key at every frame.
    layout: FileLayout = AS_RECORDED  # Layout of the skeleton in the file.
    clip: str = ""  # Name of the animation, in formats that store one, or "" for the scene's name.
    warnings: tuple[Diagnostic, ...] = ()  # Warnings of the take's solve. They are repeated when it is exported.

    @property
    def metres_a_unit(self) -> float:
        """Length of one Blender unit in metres."""
        return self.layout.metres_a_unit if self.is_plain else self.scene.unit_settings.scale_length

    @property
    def times(self) -> np.ndarray:
        """Scene frame (F,) of each frame of the take."""
        return self.first + self.step * np.arange(self.num_frames)

    @property
    def frame_start(self) -> int:
        """First frame as a whole scene frame, for file formats that use scene frames."""
        return round(self.first)

    @property
    def frame_end(self) -> int:
        """Last frame as a whole scene frame, for file formats that use scene frames."""
        return self.frame_start + self.num_frames - 1

    @property
    def is_on_frames(self) -> bool:
        """True if every frame of the take is at a whole scene frame."""
        whole = abs(self.step - 1) < _WHOLE and abs(self.first - self.frame_start) < _WHOLE
        return whole and abs(self.fps / scene_frame_rate(self.scene) - 1) < _WHOLE


def take_of(
    scene: bpy.types.Scene,
    obj: bpy.types.Object | None,
    frames: tuple[float, float] | None = None,
    fps: float | None = None,
) -> ExportTake:
    """Return the take that an armature plays. ``obj`` is the armature or a mesh that it deforms.

    ``frames`` are scene frames, by default the range of the action. A solved take keeps the duration of its motion,
    even if the scene's frame rate was changed after the bake. Raises ``NothingToExport`` if there is no armature, no
    motion or no frame.
    """
    armature = _armature(obj)
    action = current_action(armature)
    solved = action if action is not None and is_take(action) else None
    laid = scene_frame_rate(scene) if solved is None else laid_rate(solved)
    fps = own_rate(scene, armature) if fps is None else fps
    if frames is None:
        if action is None:
            hint = "Assign an action, or specify a frame range."
            raise NothingToExport("The armature has no current action.", where=armature.name, hint=hint)
        start, end = action.frame_range
        frames = (start, end) if solved is not None else (math.floor(start + _WHOLE), math.ceil(end - _WHOLE))
    if frames[1] < frames[0]:
        raise NothingToExport(f"The frames {frames[0]} to {frames[1]} are not a valid range.", where=armature.name)
    meshes = (o for o in scene.objects if o.type == "MESH" and o.find_armature() is armature)
    clip = "" if action is None else action.name
    step = 1.0 if same_rate(laid, fps) else laid / fps
    count = 1 + math.floor((frames[1] - frames[0]) / step + _SLACK)
    found = () if action is None else tuple(warnings_of_take(action))
    return ExportTake(
        armature.name, scene, armature, tuple(meshes), frames[0], count, fps, step, clip=clip, warnings=found
    )


def own_rate(scene: bpy.types.Scene, armature: bpy.types.Object) -> float:
    """Return the frame rate of the take that an armature plays. Without a take, return the scene's rate."""
    action = current_action(armature)
    return float(action["fps"]) if action is not None and is_take(action) else scene_frame_rate(scene)


@contextmanager
def chosen(take: ExportTake) -> Iterator[bpy.types.Scene]:
    """Within a ``with`` block, select only the take's objects and set the scene's range to its frames."""
    scene = take.scene
    layer = bpy.context.view_layer
    layer.update()
    objects = (take.armature, *take.meshes)
    absent = [obj.name for obj in objects if obj.name not in layer.objects]
    if absent:
        raise NothingToExport(f"{', '.join(absent)} is not in this view layer.", hint="Enable its collection.")
    selected, active = [obj for obj in layer.objects if obj.select_get()], layer.objects.active
    hidden = {obj: (obj.hide_viewport, obj.hide_get()) for obj in objects}
    frames = scene.frame_start, scene.frame_end, scene.frame_current, scene.frame_subframe
    render, units = scene.render, scene.unit_settings
    rate, scale, name = (render.fps, render.fps_base), units.scale_length, scene.name
    namesake = bpy.data.scenes.get((take.clip, None)) if take.clip != name else None  # never a linked one
    try:
        if namesake is not None:
            namesake.name = f"{take.clip} (shown)"
        scene.name = take.clip or name  # Blender's exporters name the animation after its scene
        for obj in selected:
            obj.select_set(False)
        for obj in objects:
            obj.hide_viewport = False
            obj.hide_set(False)
            obj.select_set(True)
        layer.objects.active = take.armature
        scene.frame_start, scene.frame_end = take.frame_start, take.frame_end
        if take.is_plain:
            set_scene_frame_rate(scene, take.fps)
            units.scale_length = take.metres_a_unit
        with bpy.context.temp_override(selected_objects=objects):  # a window may show another scene
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
        (render.fps, render.fps_base), units.scale_length = rate, scale
        scene.frame_set(frames[2], subframe=frames[3])
        scene.name = name
        if namesake is not None:
            namesake.name = take.clip


def uniform_scale(take: ExportTake) -> float:
    """Return the armature's world scale. Raise ``NothingToExport`` if it is mirrored or not uniform."""
    scale = float(even_scale(take.armature.matrix_world, _SAME_SIZE))
    if np.isnan(scale) or take.armature.matrix_world.determinant() < 0:
        hint = "Scale the armature and its parents equally in all directions."
        raise NothingToExport("The armature is mirrored or not scaled uniformly.", where=take.name, hint=hint)
    return 1.0 if abs(scale - 1) < _SAME_SIZE else scale


def _armature(obj: bpy.types.Object | None) -> bpy.types.Object:
    if obj is not None and obj.type == "MESH":
        obj = obj.find_armature()
    if obj is None or obj.type != "ARMATURE":
        raise NothingToExport("No armature is selected.", hint="Select the body of a take.")
    return obj


_PROGRESS_STEP = 100  # Number of frames between two progress reports. Chosen by hand.


@dataclass(frozen=True)
class PoseSamples:
    """Sampled poses of J bones in F frames, in metres and in Blender's axes (Z up)."""

    names: tuple[str, ...]  # Bone names, parents before children.
    parents: tuple[int, ...]  # Index of each bone's parent, or -1 at a root.
    rest_heads: np.ndarray  # (J, 3) bone heads at rest in the armature's frame, but in world size.
    rest_tails: np.ndarray  # (J, 3) bone tails at rest.
    rotations: np.ndarray
    """(F, J, 3, 3) world rotation of each bone from rest. It is the identity for an unmoved armature at rest."""
    heads: np.ndarray  # (F, J, 3) bone heads in the world.
    fps: float  # Frames per second.

    @property
    def num_frames(self) -> int:
        """Number F of sampled frames."""
        return len(self.heads)


def sample_pose(take: ExportTake, progress: Progress, names: tuple[str, ...] | None = None) -> PoseSamples:
    """Evaluate a take's bones in every frame: the bones in ``names``, or all deforming bones if it is None."""
    data = take.armature.data.bones
    roots = [bone for bone in data if bone.parent is None]
    names = names or tuple(b.name for root in roots for b in (root, *root.children_recursive) if b.use_deform)
    missing = [name for name in names if name not in data]
    if missing or not names:
        lacks = f"does not have the bones {', '.join(missing)}" if missing else "has no deforming bones"
        hint = "Export an armature that this add-on baked."
        raise NothingToExport(f"The armature {lacks}.", where=take.name, hint=hint)
    index = {name: i for i, name in enumerate(names)}
    above = [next((b.name for b in data[name].parent_recursive if b.name in index), "") for name in names]

    def report(frame: int) -> None:
        if frame % _PROGRESS_STEP == 0:
            progress("sampling the pose", frame, take.num_frames)

    worlds, poses = sample_poses(take.armature, take.scene, names, take.times, report)
    progress("sampling the pose", take.num_frames, take.num_frames)
    posed, rest = worlds[:, None] @ poses, np.array([data[name].matrix_local for name in names], np.float64)
    scale = take.metres_a_unit * uniform_scale(take)
    rotated = posed[..., :3, :3] / np.linalg.norm(posed[..., :3, :3], axis=-2, keepdims=True)
    return PoseSamples(
        names=names,
        parents=tuple(index.get(name, -1) for name in above),
        rest_heads=scale * rest[:, :3, 3],
        rest_tails=scale * np.array([data[name].tail_local for name in names], np.float64),
        rotations=rotated @ rest[:, :3, :3].swapaxes(1, 2),
        heads=take.metres_a_unit * posed[..., :3, 3],
        fps=take.fps,
    )


def sample_joints(take: ExportTake, progress: Progress) -> PoseSamples:
    """Evaluate only the joints of the body's tree: SMPL's 24 joints, or 52 joints with fingers."""
    return sample_pose(take, progress, layout_of(take.armature.data.bones).joints)


def against_parents(turns: np.ndarray, parents: Sequence[int]) -> np.ndarray:
    """Convert world rotations (F, J, 3, 3) to rotations relative to the parent bones. Roots do not change."""
    local = turns.copy()
    for j, parent in enumerate(parents):
        if parent >= 0:
            local[:, j] = turns[:, parent].swapaxes(1, 2) @ turns[:, j]
    return local
