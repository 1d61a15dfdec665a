"""Poses of independent frames as codes: what single frames are fitted by."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from array_api_compat import array_namespace

from solver_backend.body.state_layout import CODE, ROOT, TRANSL, StateLayout
from solver_backend.fitters.model.codes import CODES
from solver_backend.geometry.arrays import Array, astype
from solver_backend.geometry.rotations import exp_so3
from solver_backend.geometry.sphere import spherical_normalisation


@dataclass(frozen=True)
class FrameStates:
    """Unknowns of F independent frames."""

    z: Array
    """(F, 32) unit zero-mean codes."""
    root: Array
    """(F, 3, 3) body to world."""
    transl: Array
    """(F, 3) metres."""

    @classmethod
    def concatenate(cls, parts: Sequence[FrameStates]) -> FrameStates:
        """Return the frames of all parts, one part after the other."""
        xp = array_namespace(parts[0].z)
        return cls(*(xp.concat([getattr(part, name) for part in parts]) for name in ("z", "root", "transl")))

    def select(self, frames: Any) -> FrameStates:
        """Return the states at these indices or of this slice."""
        return FrameStates(self.z[frames], self.root[frames], self.transl[frames])

    def astype(self, precision: Any) -> FrameStates:
        """Return the states in a precision."""
        return FrameStates(*(astype(part, precision) for part in (self.z, self.root, self.transl)))

    def retract(self, step: Array, layout: StateLayout) -> FrameStates:
        """Return the states moved by (F, n) steps of this layout."""
        xp = array_namespace(step)
        moved = self.z + xp.matmul(CODES.tangent_basis(self.z), step[:, layout[CODE], None])[..., 0]
        root = xp.matmul(exp_so3(step[:, layout[ROOT]]), self.root)
        return FrameStates(spherical_normalisation(moved), root, self.transl + step[:, layout[TRANSL]])

    def where(self, mask: Array, other: FrameStates) -> FrameStates:
        """Return these states where the (F,) mask is true, and the other's elsewhere."""
        xp = array_namespace(mask)
        pick = mask[:, None]
        return FrameStates(
            xp.where(pick, self.z, other.z),
            xp.where(pick[..., None], self.root, other.root),
            xp.where(pick, self.transl, other.transl),
        )
