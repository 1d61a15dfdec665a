"""Labelled takes made unlabelled: tracks cut, points hidden, ghosts added, columns shuffled; and how labels did."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from solver_backend.body.marker_names import is_unnamed, name_markers
from solver_backend.labelling.label_take import LabelledTake
from solver_backend.labelling.outputs import GHOST, MARKERS
from solver_backend.types import MarkerCloud


@dataclass(frozen=True)
class UnlabelledTake:
    """A cloud without names, and what its points are."""

    cloud: MarkerCloud
    truth: np.ndarray
    """(F, N) marker of each point, ``GHOST`` for none, -1 where there is none."""


@dataclass(frozen=True)
class Score:
    """Shares of the points, in percent."""

    right: float
    wrong: float
    unknown: float


def in_the_superset(cloud: MarkerCloud) -> tuple[MarkerCloud, np.ndarray]:
    """Return the markers of a labelled take that the superset has, and which they are."""
    labels = cloud.labels or ()
    known = name_markers([label for label in labels if not is_unnamed(label)]).known
    kept = [i for i, label in enumerate(labels) if known.get(label) in MARKERS]
    which = np.array([MARKERS.index(known[labels[i]]) for i in kept])
    return replace(cloud, positions=cloud.positions[:, kept], labels=tuple(labels[i] for i in kept)), which


def stripped(
    cloud: MarkerCloud, seed: int, *, cuts_per_s: float = 0.3, missing: int = 0, ghosts: int = 0
) -> UnlabelledTake:
    """Return a take whose tracks are cut at random times and go on in other columns.

    Args:
        cloud: labelled, the superset's markers count.
        seed: of all draws.
        cuts_per_s: of each track.
        missing: markers hidden at any time, for a second or so each.
        ghosts: points that are none of the markers, at any time, wandering about the body.
    """
    cloud, which = in_the_superset(cloud)
    rng = np.random.default_rng(seed)
    positions = cloud.positions.copy()
    frames, markers = positions.shape[:2]
    for _ in range(missing):
        start = 0
        while start < frames:
            length = int(rng.uniform(0.5, 1.5) * cloud.fps)
            positions[start : start + length, rng.integers(markers)] = np.nan
            start += length
    pieces: list[tuple[int, int, int]] = []
    for marker in range(markers):
        cuts = np.flatnonzero(rng.random(frames - 1) < cuts_per_s / cloud.fps) + 1
        edges = [0, *cuts.tolist(), frames]
        pieces += [(marker, a, b) for a, b in pairwise(edges)]
    order = rng.permutation(len(pieces))
    slots: list[tuple[int, list[tuple[int, int, int]]]] = []
    for marker, a, b in sorted((pieces[i] for i in order), key=lambda p: (p[1], rng.random())):
        open_ = [i for i, (end, _) in enumerate(slots) if end <= a]
        if open_:
            chosen = open_[rng.integers(len(open_))]
            slots[chosen][1].append((marker, a, b))
            slots[chosen] = (b, slots[chosen][1])
        else:
            slots.append((b, [(marker, a, b)]))
    columns = rng.permutation(len(slots))
    found = np.full((frames, len(slots) + ghosts, 3), np.nan)
    truth = np.full(found.shape[:2], -1)
    for column, slot in zip(columns, slots, strict=True):
        for marker, a, b in slot[1]:
            found[a:b, column] = positions[a:b, marker]
            truth[a:b, column] = np.where(np.isfinite(positions[a:b, marker, 0]), which[marker], -1)
    for ghost in range(ghosts):
        found[:, len(slots) + ghost] = _wandering(positions, cloud.fps, rng)
        truth[:, len(slots) + ghost] = GHOST
    return UnlabelledTake(MarkerCloud(found, cloud.fps), truth)


def _wandering(positions: np.ndarray, fps: float, rng: np.random.Generator) -> np.ndarray:
    """Return (F, 3) of a ghost that appears for a third of a second now here, now there, within the points' reach."""
    path = np.empty((len(positions), 3))
    step = max(1, round(0.33 * fps))
    for start in range(0, len(positions), step):
        frame = positions[start][np.isfinite(positions[start]).all(-1)]
        mean, spread = np.median(frame, axis=0), np.cov(frame.T)
        path[start : start + step] = rng.multivariate_normal(mean, spread) + 0.002 * rng.standard_normal(
            (len(path[start : start + step]), 3)
        )
    return path


def score(take: LabelledTake | np.ndarray, truth: np.ndarray) -> Score:
    """Return how many points have their label, another, or none; a ghost that stays unknown is right, too."""
    labels = take if isinstance(take, np.ndarray) else take.labels
    there = truth >= 0
    told, true = labels[there], truth[there]
    unknown = (told < 0) & (true != GHOST)
    # Calling a marker "none of them" is to say nothing of it.
    unknown |= (told == GHOST) & (true != GHOST)
    right = (told == true) | ((told < 0) & (true == GHOST))
    wrong = ~right & ~unknown
    return Score(*(100.0 * float(part.mean()) for part in (right, wrong, unknown)))
