"""The bones of a take on every frame, as arrays."""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np

from .._exchange.progress import Progress
from ..conventions.skeleton import layout_of
from ..conventions.timing import go_to_frame
from ..errors import NothingToExport
from .take import ExportTake, staged, uniform_scale

_PROGRESS_STEP = 100
"""Frames from one report of progress to the next; chosen by hand."""


@dataclass(frozen=True)
class PoseSamples:
    """J bones over F frames; metres, Blender's axes (Z up)."""

    names: tuple[str, ...]
    """The bones, parents before children."""
    parents: tuple[int, ...]
    """Index of each bone's parent, -1 at a root."""
    rest_heads: np.ndarray
    """(J, 3) heads at rest in the armature's frame, as large as the world shows it."""
    rest_tails: np.ndarray
    """(J, 3) tails at rest."""
    rotations: np.ndarray
    """(F, J, 3, 3) each bone's rotation from rest, armature's frame to world: identity at rest if that is unmoved."""
    heads: np.ndarray
    """(F, J, 3) heads in the world."""
    fps: float
    """Frames per second."""

    @property
    def num_frames(self) -> int:
        """Number of frames."""
        return len(self.heads)


def sample_pose(take: ExportTake, progress: Progress, names: tuple[str, ...] | None = None) -> PoseSamples:
    """Evaluate a take frame by frame.

    Args:
        names: bones; None for all that deform.

    Raises:
        NothingToExport: the armature lacks one of the bones, or has none that deform.
    """
    bones = {bone.name: bone for bone in _parents_first(take.armature)}
    names = tuple(name for name, bone in bones.items() if bone.use_deform) if names is None else names
    missing = [name for name in names if name not in bones]
    if missing or not names:
        raise NothingToExport(
            f"The armature lacks the bones {', '.join(missing)}."
            if missing
            else "The armature has no deforming bones.",
            where=take.name,
            hint="Export an armature that this add-on baked.",
        )
    index = {name: i for i, name in enumerate(names)}
    rest = np.array([bones[name].matrix_local for name in names], np.float64)
    posed = np.empty((take.num_frames, len(names), 4, 4))
    metres, times = take.metres_a_unit, take.times
    with staged(take) as (stage, depsgraph):
        for f in range(take.num_frames):
            go_to_frame(stage, float(times[f]))
            shown = take.armature.evaluated_get(depsgraph)
            posed[f] = np.array(shown.matrix_world) @ np.array([shown.pose.bones[name].matrix for name in names])
            if f % _PROGRESS_STEP == 0:
                progress("sampling the pose", f, take.num_frames)
    progress("sampling the pose", take.num_frames, take.num_frames)
    scale = metres * uniform_scale(take)
    rotated = posed[..., :3, :3] / np.linalg.norm(posed[..., :3, :3], axis=-2, keepdims=True)
    return PoseSamples(
        names=names,
        parents=tuple(_parent(bones[name], index) for name in names),
        rest_heads=scale * rest[:, :3, 3],
        rest_tails=scale * np.array([bones[name].tail_local for name in names], np.float64),
        rotations=rotated @ rest[:, :3, :3].swapaxes(1, 2),
        heads=metres * posed[..., :3, 3],
        fps=take.fps,
    )


def sample_joints(take: ExportTake, progress: Progress) -> PoseSamples:
    """Evaluate the joints of the body's tree alone: SMPL's 24, or 52 with fingers."""
    return sample_pose(take, progress, layout_of(take.armature.data.bones).joints)


def _parents_first(armature: bpy.types.Object) -> list[bpy.types.Bone]:
    roots = [bone for bone in armature.data.bones if bone.parent is None]
    return [bone for root in roots for bone in (root, *root.children_recursive)]


def _parent(bone: bpy.types.Bone, index: dict[str, int]) -> int:
    above = bone.parent
    while above is not None and above.name not in index:
        above = above.parent
    return -1 if above is None else index[above.name]
