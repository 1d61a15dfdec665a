"""What the bundle minimises: the terms of its frames (``fitters.objective``) and the terms over its keyframes.

``E(x) = Σ_f E_frame(x_f) + Σ_t E_t(keys)``, where the frames f are what the curves through the keys make of them:

==================  ==============================  ======================================  =========================
term                file                            penalises                               weight
==================  ==============================  ======================================  =========================
temporal prior      keyframes/temporal_prior        acceleration; speed where nobody is     1 / (sigma spacing²)²
                                                    seen
residual rotations  keyframes/residual_rotation     joints off the prior's manifold, with   1 / sigma²
                                                    heavy tails; bends over three keys
==================  ==============================  ======================================  =========================

The published bundle (thesis eqs. 6.6-6.8) has the reprojection term alone; the others are ours.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Protocol

from solver_backend.body.state_layout import StateLayout
from solver_backend.fitters.keyframes.normal_equations import KeyframeNormalEquations
from solver_backend.fitters.keyframes.residual_rotation import ResidualRotationTerm
from solver_backend.fitters.keyframes.temporal_prior import MotionPrior
from solver_backend.fitters.model.keyframe_layout import KeyframeLayout
from solver_backend.fitters.model.keyframes import Keyframes
from solver_backend.fitters.objective import FrameObjective
from solver_backend.fitters.problem import Problem
from solver_backend.fitters.settings import SolveSettings
from solver_backend.geometry.arrays import Array
from solver_backend.residuals.point_term import PointTerm

OFF_MANIFOLD = 1.25
"""How much further poses may leave the prior's manifold than its held-out subjects' do: takes that are solved move more
unlike its corpus. Chosen on strange bodies; 1.5 gains as much again on dance and loses 1 % on exercises."""


class KeyTerm(Protocol):
    """Anything that evaluates keyframes."""

    def part(self, keys: slice) -> KeyTerm:
        """Return the term of some of the keys."""
        ...

    def cost(self, keys: Keyframes, free: StateLayout) -> Array:
        """Return the energy (K,) at each of these keys, of what some of the free blocks change."""
        ...

    def add_to(self, equations: KeyframeNormalEquations, keys: Keyframes) -> None:
        """Add the equations of these keys to those of the data, in place."""
        ...


@dataclass(frozen=True)
class BundleObjective:
    """The terms of F frames and of the keys that make them."""

    frames: FrameObjective
    """Of all frames of the take."""
    keys: tuple[KeyTerm, ...] = ()
    """Over neighbouring keys, and on each."""

    def part(self, keys: slice) -> BundleObjective:
        """Return the objective of some of the keys; frames are picked by their numbers."""
        return replace(self, keys=tuple(term.part(keys) for term in self.keys))

    def astype(self, precision: Any) -> BundleObjective:
        """Return the objective with measurements in a precision; the terms over keys take on that of the keys."""
        return replace(self, frames=self.frames.astype(precision))


def bundle_objective(
    problem: Problem,
    layout: KeyframeLayout,
    window: int,
    points: tuple[PointTerm, ...],
    settings: SolveSettings,
    *,
    residuals: bool,
    looseness: float = OFF_MANIFOLD,
) -> BundleObjective:
    """Return what the global method minimises.

    Args:
        problem: the measurements made ready.
        layout: windows of the keys, which stand half a window apart.
        window: frames of a window.
        points: the data, and contacts where feet stand.
        settings: how strongly terms act; a term that a setting switches on is added here.
        residuals: keys may leave the prior's manifold.
        looseness: joints may leave the manifold by so many times the prior's error.
    """
    spacing = 0.5 * window
    terms: list[KeyTerm] = [
        MotionPrior.bounded(spacing / problem.fps, settings.smoothing, layout.gaps(problem.measurements.seen))
    ]
    if residuals:
        prior = problem.prior
        sigma = looseness * prior.residual_sigma
        terms.append(ResidualRotationTerm(sigma, 0.5 * spacing, uncovered=prior.uncovered))
    measured = problem.measurements
    frames = FrameObjective((*points, *measured.beside), problem.pose_terms, measured.relative)
    return BundleObjective(frames, tuple(terms))
