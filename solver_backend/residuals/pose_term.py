"""Terms on poses: what each tells the solver of the rotations of joints 1..21, whatever was measured."""

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
    """(F, 63) by the joints' left tangents, 1/rad."""
    factors: Array
    """(F, n) what the term's ``hessian`` is formed from, where it is asked for."""


class PoseTerm(FrameTerm, Protocol):
    """Anything that judges poses one by one."""

    def __call__(self, local: Array) -> PoseEvidence:
        """Return the evidence at (F, 21, 3, 3) rotations."""
        ...

    def hessian(self, factors: Array) -> Array:
        """Return the (F, 63, 63) positive semidefinite matrices that these factors stand for, 1/rad²."""
        ...
