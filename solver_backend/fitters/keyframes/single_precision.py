"""Bundles in single precision: half the memory's traffic, for measurements of which fifteen digits say no more."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from array_api_compat import array_namespace

from solver_backend.fitters.keyframes.optimise import BundleModel
from solver_backend.fitters.model.keyframes import Keyframes
from solver_backend.geometry.arrays import Array
from solver_backend.residuals.point_term import PointTerm
from solver_backend.residuals.positions import PositionTerm


def halved(model: BundleModel) -> BundleModel:
    """Return the model with person and measured positions in single precision: a metre to 0.1 µm."""
    single = array_namespace(model.subject.betas).float32
    subject = replace(model.subject, betas=_as(model.subject.betas, single), offsets=_as(model.subject.offsets, single))
    points = tuple(_term(term, single) for term in model.objective.frames.points)
    frames = replace(model.objective.frames, points=points)
    return replace(model, subject=subject, objective=replace(model.objective, frames=frames))


def keys_as(keys: Keyframes, like: Array) -> Keyframes:
    """Return the keys in the precision of ``like``."""
    return Keyframes(*(_as(part, like.dtype) for part in (keys.z, keys.quat, keys.transl, keys.residual)))


def _term(term: PointTerm, precision: Any) -> PointTerm:
    if isinstance(term, PositionTerm):
        return PositionTerm(_as(term.positions, precision), _as(term.weight, precision))
    return term


def _as(values: Array, precision: Any) -> Array:
    return array_namespace(values).astype(values, precision)
