"""Markers of unknown name: attached to the bone that they move with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.body.markers import ON_BONE
from solver_backend.types import NUM_BODY_JOINTS, SMPL_JOINTS

LEAST_FRAMES = 8
"""Frames in which a marker must be seen to identify its bone."""
RESIDUAL_M = 0.03
"""A marker that stays no closer to any bone's frame is worn by nobody (a wand, another person, a ghost)."""
REACH_M = 0.45
"""Nor is one that is so far from its bone's joint."""
_MEDIAN_LENGTH = 1.54
"""Standard deviations per axis that are the median length of a three-dimensional Gaussian."""


@dataclass(frozen=True)
class Attachment:
    """What a marker moves with."""

    place: str
    """``@`` and the name of the bone's joint."""
    offset: np.ndarray
    """(3,) metres from the joint, in the bone's rest frame."""
    sigma_m: float
    """Standard deviation around it per axis, metres."""

    @classmethod
    def on_bone(cls, bone: int, offset: np.ndarray, spread: np.ndarray) -> Attachment:
        """Return what ``bone_offsets`` has of one bone: its offset (22, 3), and its median distance (22,) from that."""
        return cls(ON_BONE + SMPL_JOINTS[bone], offset[bone], float(spread[bone] / _MEDIAN_LENGTH))


def attach(
    points: np.ndarray, joints: np.ndarray, rotations: np.ndarray, named: str | None = None
) -> Attachment | None:
    """Return the bone to which a marker has the most constant offset; None where it has none.

    For every bone j the offset is ``o_j = median_f G_jᵀ (x - p_j)``, the median of each axis, which single wrong points
    do not move; the bone around whose offset the marker stays closest has it. Where another bone is as good within the
    noise, the one whose joint is nearest is taken.

    Args:
        points: (F, 3) metres, NaN where missing.
        joints: (F, 24, 3) metres.
        rotations: (F, 24, 3, 3) global rotations of the bones.
        named: joint of the bone that the marker's label names, the only one that it may be on.
    """
    if np.isfinite(points).all(-1).sum() < LEAST_FRAMES:
        return None
    offset, spread, reach = bone_offsets(points, joints, rotations)
    spread = np.where(reach > REACH_M, np.inf, spread)
    if named is not None:
        spread = np.where(np.arange(len(spread)) == SMPL_JOINTS.index(named), spread, np.inf)
    near = np.flatnonzero(spread <= 1.1 * spread.min() + 1e-4)
    best = int(near[np.argmin(reach[near])])
    if not spread[best] < RESIDUAL_M:
        return None
    return Attachment.on_bone(best, offset, spread)


def bone_offsets(
    points: np.ndarray, joints: np.ndarray, rotations: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return a marker's offset (22, 3) from every bone, its median distance (22,) from that, and the offset's length.

    Args:
        points: (F, 3) metres, NaN where missing.
        joints: (F, 24, 3) metres.
        rotations: (F, 24, 3, 3) global rotations of the bones.
    """
    seen, count = np.isfinite(points).all(-1), 1 + NUM_BODY_JOINTS
    away = points[seen, None] - joints[seen, :count]
    local = (np.swapaxes(rotations[seen, :count], -1, -2) @ away[..., None])[..., 0]
    offset = np.median(local, axis=0)
    return offset, np.median(np.linalg.norm(local - offset, axis=-1), axis=0), np.linalg.norm(offset, axis=-1)
