"""Poses of a body over frames: rotations of the root and of joints 1..21, and where the root stands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from array_api_compat import array_namespace

from solver_backend.exchange.joint_sets import NUM_BODY_JOINTS
from solver_backend.fitters.model.tangent import PoseTangent
from solver_backend.geometry.arrays import Array
from solver_backend.geometry.rotations import exp_so3

BLOCK_POSES = 500
"""Frames posed at a time."""


@dataclass(frozen=True)
class PosedFrames:
    """Poses of F frames."""

    root: Array
    """(F, 3, 3) body to world."""
    local: Array
    """(F, 21, 3, 3) rotations of joints 1..21."""
    transl: Array
    """(F, 3) metres."""

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
        """Return the poses moved by (F, 69) steps, ``exp([δ]x) R`` and ``t + δ``; see ``PoseTangent``."""
        xp = array_namespace(step)
        turns = exp_so3(xp.reshape(step[:, PoseTangent.ROTATIONS], (step.shape[0], 1 + NUM_BODY_JOINTS, 3)))
        root, local = xp.matmul(turns[:, 0], self.root), xp.matmul(turns[:, 1:], self.local)
        return PosedFrames(root, local, self.transl + step[:, PoseTangent.TRANSL])
