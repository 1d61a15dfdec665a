"""Columns of a take that the network labelled, under a person's labels: which have no name of theirs, and new names."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from solver_backend.body.marker_names import is_unnamed
from solver_backend.body.markers import ON_BONE
from solver_backend.types import MarkerCloud, MarkerSubject


def in_words_of(person: MarkerSubject, cloud: MarkerCloud) -> MarkerCloud:
    """Return a take whose names of places are the person's labels there."""
    own = {
        place: label for label, place in zip(person.labels, person.places, strict=True)
        if not place.startswith(ON_BONE) and label not in (cloud.labels or ())
    }  # fmt: skip
    return replace(cloud, labels=tuple(own.get(label, label) for label in cloud.labels or ()))


def nameless_columns(cloud: MarkerCloud, others: Collection[str] = ()) -> np.ndarray:
    """Return the columns without names, and those of markers that the person does not wear."""
    return np.flatnonzero([is_unnamed(label) or label in others for label in cloud.labels or ()])


def missing_markers(cloud: MarkerCloud, person: MarkerSubject) -> np.ndarray:
    """Return (F, L) where a marker of the person is not seen under its name: a point without one may be it."""
    missing = np.ones((len(cloud.positions), len(person.labels)), dtype=bool)
    for m, label in enumerate(person.labels):
        if label in (cloud.labels or ()):
            missing[:, m] = ~np.isfinite(cloud.positions[:, (cloud.labels or ()).index(label)]).all(-1)
    return missing


def with_names(cloud: MarkerCloud, columns: np.ndarray, which: np.ndarray, labels: Sequence[str]) -> MarkerCloud:
    """Return the take with the points of each marker that was found under its label; the others stay where they are.

    Args:
        cloud: F frames.
        columns: (N,) columns that were looked at.
        which: (F, N) marker of each of their points, -1 where none.
        labels: of the markers.
    """
    parts = [cloud.positions]
    if cloud.residual is not None:
        parts.append(cloud.residual[..., None])
    if cloud.covariance is not None:
        parts.append(cloud.covariance.reshape(*cloud.positions.shape[:2], 9))
    given, names = np.concatenate(parts, axis=-1), list(cloud.labels or ())
    values = given.copy()
    f, n = np.nonzero(which >= 0)
    values[f, columns[n]] = np.nan
    for marker in map(int, np.unique(which[which >= 0])):
        f, n = np.nonzero(which == marker)
        column = names.index(labels[marker]) if labels[marker] in names else len(names)
        before = values[f, column] if column < len(names) else np.zeros((0, 3))
        # What the network named so meanwhile is another point, which has no name then.
        ousted = column < len(names) and bool(np.isfinite(before[:, 0]).any())
        for name in [*([labels[marker]] if column == len(names) else []), *([_unused(names)] if ousted else [])]:
            names.append(name)
            values = np.concatenate([values, np.full_like(values[:, :1], np.nan)], axis=1)
        if ousted:
            values[f, -1] = before
        values[f, column] = given[f, columns[n]]
    kept = [i for i in range(len(names)) if i not in columns or np.isfinite(values[:, i, 0]).any()]
    values = values[:, kept]
    return replace(
        cloud, positions=values[..., :3], labels=tuple(names[i] for i in kept),
        residual=None if cloud.residual is None else values[..., 3],
        covariance=None if cloud.covariance is None else values[..., -9:].reshape(*values.shape[:2], 3, 3),
    )  # fmt: skip


def _unused(names: Sequence[str]) -> str:
    """Return a name such as programs give points that nobody named."""
    return next(name for k in range(len(names) + 1) if (name := f"*{k}") not in names)
