"""Poses of independent frames as codes: what single frames are fitted by."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from array_api_compat import array_namespace

from solver_backend.body.state_layout import CODE, ROOT, TRANSL, StateLayout
from solver_backend.fitters.model.codes import CODES
from solver_backend.fitters.model.keyframes import rotations_of
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

    residual: Array | None = None
    """(F, J, 3) rotation vectors beside the code, radians; None where joints stay on the prior's manifold."""

    @classmethod
    def concatenate(cls, parts: Sequence[FrameStates]) -> FrameStates:
        """Return the frames of all parts, one part after the other."""
        xp = array_namespace(parts[0].z)
        columns = zip(*(part.arrays for part in parts), strict=True)
        return cls(*(None if column[0] is None else xp.concat(column) for column in columns))

    @property
    def arrays(self) -> tuple[Array | None, ...]:
        """Codes, roots, translations and rotation vectors."""
        return self.z, self.root, self.transl, self.residual

    def select(self, frames: Any) -> FrameStates:
        """Return the states at these indices or of this slice."""
        return FrameStates(*(None if part is None else part[frames] for part in self.arrays))

    def astype(self, precision: Any) -> FrameStates:
        """Return the states in a precision."""
        return FrameStates(*(None if part is None else astype(part, precision) for part in self.arrays))

    def retract(self, step: Array, layout: StateLayout) -> FrameStates:
        """Return the states moved by (F, n) steps of this layout."""
        xp, residual = array_namespace(step), self.residual
        moved = self.z + xp.matmul(CODES.tangent_basis(self.z), step[:, layout[CODE], None])[..., 0]
        root = xp.matmul(exp_so3(step[:, layout[ROOT]]), self.root)
        if residual is not None and layout.turned:
            residual = residual + rotations_of(step, layout, residual.shape[1])
        return FrameStates(spherical_normalisation(moved), root, self.transl + step[:, layout[TRANSL]], residual)

    def where(self, mask: Array, other: FrameStates) -> FrameStates:
        """Return these states where the (F,) mask is true, and the other's elsewhere."""
        xp = array_namespace(mask)

        def pick(own: Array | None, others: Array | None) -> Array | None:
            if own is None or others is None:
                return own
            return xp.where(xp.reshape(mask, (-1, *[1] * (own.ndim - 1))), own, others)

        return FrameStates(*(pick(*pair) for pair in zip(self.arrays, other.arrays, strict=True)))
