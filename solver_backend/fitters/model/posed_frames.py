"""Poses of a body over frames: rotations of the root and of the joints after it, and where the root stands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from array_api_compat import array_namespace

from solver_backend.body.state_layout import PoseLayout
from solver_backend.geometry.arrays import Array, constant
from solver_backend.geometry.rotations import exp_so3
from solver_backend.types import Motion

BLOCK_POSES = 500
"""Frames posed at a time; changes time and memory, no result."""


@dataclass(frozen=True)
class PosedFrames:
    """Poses of F frames."""

    root: Array
    """(F, 3, 3) body to world."""
    local: Array
    """(F, J, 3, 3) rotations of the J joints after the root."""
    transl: Array
    """(F, 3) metres."""

    @property
    def layout(self) -> PoseLayout:
        """Where the parts of a frame's tangent stand."""
        return PoseLayout(self.local.shape[1])

    @classmethod
    def of_motion(cls, motion: Motion, like: Array) -> PosedFrames:
        """Return a motion's poses, with the rotations of the joints that a solve turns."""
        vectors = motion.body_pose.reshape(motion.num_frames, -1, 3)[:, : motion.body_layout.num_solved]
        root, local = (exp_so3(constant(part, like)) for part in (motion.global_orient, vectors))
        return cls(root, local, constant(motion.transl, like))

    @classmethod
    def concatenate(cls, parts: Sequence[PosedFrames]) -> PosedFrames:
        """Return the frames of all parts, one part after the other."""
        xp = array_namespace(parts[0].transl)
        return cls(*(xp.concat([getattr(part, name) for part in parts]) for name in ("root", "local", "transl")))

    def select(self, frames: Any) -> PosedFrames:
        """Return the poses at these indices, of this slice or where this mask is true."""
        return PosedFrames(self.root[frames], self.local[frames], self.transl[frames])

    def where(self, mask: Array, other: PosedFrames) -> PosedFrames:
        """Return these poses where the (F,) mask is true, and the other's elsewhere."""
        xp = array_namespace(mask)
        return PosedFrames(
            xp.where(mask[:, None, None], self.root, other.root),
            xp.where(mask[:, None, None, None], self.local, other.local),
            xp.where(mask[:, None], self.transl, other.transl),
        )

    def retract(self, step: Array) -> PosedFrames:
        """Return the poses moved by (F, p) steps, ``exp([δ]x) R`` and ``t + δ``; see ``PoseLayout``."""
        xp, layout = array_namespace(step), self.layout
        turns = exp_so3(xp.reshape(step[:, layout.rotations], (step.shape[0], -1, 3)))
        root, local = xp.matmul(turns[:, 0], self.root), xp.matmul(turns[:, 1:], self.local)
        return PosedFrames(root, local, self.transl + step[:, layout.transl])
