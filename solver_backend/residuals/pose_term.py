"""Terms on poses: what each gives the solver about the rotations of the joints, whatever was measured."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from solver_backend.geometry.arrays import Array
from solver_backend.residuals.frame_term import FrameTerm


@dataclass(frozen=True)
class PoseEvidence:
    """Model of a term around F poses."""

    cost: Array
    """(F,)."""
    gradient: Array
    """(F, 3 J) by the joints' left tangents, 1/rad."""
    factors: Array
    """(F, n) what the term's ``hessian`` is formed from, where it is asked for."""


class PoseTerm(FrameTerm, Protocol):
    """Anything that evaluates poses one by one."""

    def __call__(self, local: Array) -> PoseEvidence:
        """Return the evidence at (F, J, 3, 3) rotations."""
        ...

    def hessian(self, factors: Array) -> Array:
        """Return the (F, 3 J, 3 J) positive semidefinite matrices that these factors stand for, 1/rad²."""
        ...
