"""What is minimised over posed frames: a list of terms, each with its own residual and weight.

``E(x) = Σ_f [ Σ_p E_p(y(x_f)) + Σ_q E_q(R(x_f)) ]`` with the landmarks y and the joints' rotations R of frame f:

=================  ==========================  ============================================  ===========================
term               file                        penalises                                     weight
=================  ==========================  ============================================  ===========================
reprojection       residuals/reprojection      landmarks off the detections (thesis 6.8)     confidence / noise variance
positions          residuals/positions         landmarks off measured 3D points              1 / noise variance
foot contact       residuals/foot_contact      planted points off their anchors              1 / SIGMA_M²
floor              residuals/floor             points below the floor (one camera)           1 / SIGMA_M²
relative positions residuals/relative_positions points off a lifted pose, wherever it is      lifter's precision
pose mixture       residuals/pose_mixture      unusual poses, and all turns away from rest   WEIGHT, rest_precision
=================  ==========================  ============================================  ===========================

The terms over keyframes, and the list of what the bundle minimises, are in ``keyframes/bundle_objective``.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from operator import add
from typing import Any

from solver_backend.geometry.arrays import Array
from solver_backend.residuals.point_term import PointEvidence, PointTerm
from solver_backend.residuals.pose_term import PoseTerm


@dataclass(frozen=True)
class FrameObjective:
    """The terms of F frames."""

    points: tuple[PointTerm, ...]
    """On landmark positions; at least one."""
    poses: tuple[PoseTerm, ...] = ()
    """On the joints' rotations."""
    relative: tuple[PointTerm, ...] = ()
    """On landmark positions but for a shift that all of them share."""

    def select(self, frames: Any) -> FrameObjective:
        """Return the terms of the frames at these indices (or of this slice)."""
        points, relative = (tuple(term.select(frames) for term in terms) for terms in (self.points, self.relative))
        return FrameObjective(points, tuple(term.select(frames) for term in self.poses), relative)

    def astype(self, precision: Any) -> FrameObjective:
        """Return the terms in a precision."""
        points, relative = (tuple(term.astype(precision) for term in terms) for terms in (self.points, self.relative))
        return FrameObjective(points, tuple(term.astype(precision) for term in self.poses), relative)

    def of_points(self, points: Array, scale: float) -> PointEvidence:
        """Return the sum of the point terms at (F, L, 3) positions; ``scale`` is the robust scale."""
        return reduce(add, [term(points, scale) for term in self.points])
