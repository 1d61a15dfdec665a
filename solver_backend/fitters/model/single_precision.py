"""Person and measurements in single precision: half the memory's traffic, where more digits say no more."""

from __future__ import annotations

from dataclasses import replace

from array_api_compat import array_namespace

from solver_backend.fitters.model.subject import Subject
from solver_backend.fitters.objective import FrameObjective
from solver_backend.geometry.arrays import astype
from solver_backend.residuals.point_term import PointTerm
from solver_backend.residuals.positions import PositionTerm
from solver_backend.residuals.reprojection import ReprojectionTerm


def single_subject(subject: Subject) -> Subject:
    """Return the person in single precision."""
    single = array_namespace(subject.betas).float32
    return replace(subject, betas=astype(subject.betas, single), offsets=astype(subject.offsets, single))


def single_objective(objective: FrameObjective) -> FrameObjective:
    """Return the objective with measurements in single precision: a metre to 0.1 µm, a thousand pixels to 0.0001."""
    return replace(objective, points=tuple(_single(term) for term in objective.points))


def _single(term: PointTerm) -> PointTerm:
    if isinstance(term, PositionTerm):
        single = array_namespace(term.weight).float32
        metric = None if term.metric is None else astype(term.metric, single)
        return PositionTerm(astype(term.positions, single), astype(term.weight, single), metric)
    if isinstance(term, ReprojectionTerm):
        single = array_namespace(term.weight).float32
        K, distortion, R, t = (astype(a, single) for a in (term.K, term.distortion, term.R, term.t))
        xy, weight, confidence = (astype(a, single) for a in (term.xy, term.weight, term.confidence))
        return ReprojectionTerm(K, distortion, R, t, term.model, xy, weight, confidence)
    return term
