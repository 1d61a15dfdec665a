"""A BVH clip as a moving skeleton: places where chains end are joints too."""

from __future__ import annotations

import numpy as np

from solver_backend.exchange.rigs.skeleton import Skeleton
from solver_backend.exchange.skeleton_file import require_distinct
from solver_backend.io.motions.bvh import BvhClip
from solver_backend.types import SkeletonMotion


def bvh_skeleton(clip: BvhClip, where: str = "BVH") -> Skeleton:
    """Return the clip's skeleton at rest in the clip's unit.

    Raises:
        MotionInvalid: two of its joints, ends of chains among them, have the same name.
    """
    ends = {name: f"{name} end" for name, offset in clip.end_offsets.items() if np.linalg.norm(offset) > 0.0}
    require_distinct((*clip.names, *ends.values()), where)
    places: dict[str, np.ndarray] = {}
    parents: dict[str, str] = {}
    for j, (name, parent) in enumerate(zip(clip.names, clip.parents, strict=True)):
        places[name] = clip.offsets[j] + (places[clip.names[parent]] if parent >= 0 else 0.0)
        if parent >= 0:
            parents[name] = clip.names[parent]
    for name, end in ends.items():
        places[end], parents[end] = places[name] + clip.end_offsets[name], name
    return Skeleton(places, parents)


def bvh_motion(clip: BvhClip, skeleton: Skeleton, metres: float, name: str) -> SkeletonMotion:
    """Return the clip's motion.

    Args:
        clip: as read.
        skeleton: from ``bvh_skeleton``.
        metres: of the clip's unit.
        name: of the take.
    """
    joints, turns = clip.posed()
    ends = [(clip.names.index(end.removesuffix(" end")), end) for end in skeleton.names[len(clip.names) :]]
    if ends:
        bones = [bone for bone, _ in ends]
        offsets = np.array([clip.end_offsets[clip.names[bone]] for bone in bones])
        tips = joints[:, bones] + (turns[:, bones] @ offsets[..., None])[..., 0]
        joints, turns = np.concatenate([joints, tips], axis=1), np.concatenate([turns, turns[:, bones]], axis=1)
    return SkeletonMotion(
        name, skeleton.names, tuple(skeleton.parents), metres * skeleton.heads, metres * joints, turns, clip.fps
    )
