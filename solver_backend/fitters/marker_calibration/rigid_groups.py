"""Which markers move as one rigid body: those whose distances from one another stay the same while they move."""

from __future__ import annotations

import numpy as np

from solver_backend.geometry.quantiles import quantile

LEAST_MARKERS = 3
"""Fewer have no orientation."""
STRAYS_M = 0.006
"""A distance of a rigid body stays so near to its median in ``SHARE`` of the frames: markers of 2 mm noise per axis
stray by 5.5 mm, a racket's frame bends by 3 mm in a stroke (Brody 1995)."""
SHARE = 0.95
MOVES_M = 0.05
"""A group whose markers stay nearer than so to one place all along is no prop but part of the room."""
LEAST_FRAMES, FRAMES = 15, 400
"""Frames in which two markers must be seen together, and frames of a take that are looked at."""
MOST = 100
"""Markers that are looked at, those seen most: distances of all pairs are formed."""


def rigid_groups(points: np.ndarray) -> list[list[int]]:
    """Return groups of three or more markers that keep their distances and move, the largest first.

    Each is a clique, grown from the marker that keeps its distance to most others by whichever fits the most members;
    a marker that was never seen beside a member must fit three others.

    Args:
        points: (F, N, 3) metres, NaN where missing.
    """
    frames = np.unique(np.linspace(0, len(points) - 1, min(len(points), FRAMES)).astype(int))
    seen = np.isfinite(points).all(-1)
    looked = np.argsort(-seen.sum(axis=0), kind="stable")[:MOST]
    constant, together = _constant(points[np.ix_(frames, looked)])
    groups, left = list[list[int]](), set(range(len(looked)))
    while left:
        group = _clique(constant, together, sorted(left))
        if len(group) < LEAST_MARKERS:
            break
        left -= set(group)
        groups.append(sorted(int(looked[m]) for m in group))
    return [group for group in groups if _moves(points[:, group])]


def _constant(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (N, N) whether distances are constant, and whether two markers are seen together often enough."""
    count = points.shape[1]
    constant, together = np.zeros((count, count), dtype=bool), np.zeros((count, count), dtype=bool)
    for m in range(count):
        away = np.linalg.norm(points - points[:, m : m + 1], axis=-1)
        together[m] = np.isfinite(away).sum(axis=0) >= min(LEAST_FRAMES, len(points))
        strays = quantile(np.abs(away - quantile(away, 0.5, axis=0)), SHARE, axis=0)
        constant[m] = together[m] & (np.nan_to_num(strays, nan=np.inf) < STRAYS_M)
    np.fill_diagonal(constant, False)
    return constant, together


def _clique(constant: np.ndarray, together: np.ndarray, left: list[int]) -> list[int]:
    """Return a clique among the markers that are left, grown from the best connected one."""
    degree = constant[np.ix_(left, left)].sum(axis=0)
    group = [left[int(degree.argmax())]]
    while True:
        fits = constant[group].sum(axis=0)
        fitting = [
            m
            for m in left
            if m not in group and not (together[m, group] & ~constant[m, group]).any()
            and fits[m] >= min(len(group), LEAST_MARKERS)
        ]  # fmt: skip
        if not fitting:
            return group
        group.append(max(fitting, key=lambda m: (fits[m], degree[left.index(m)])))


def _moves(points: np.ndarray) -> bool:
    """Return whether some of (F, M, 3) points leave the place where they usually are."""
    away = np.linalg.norm(points - quantile(points, 0.5, axis=0), axis=-1)
    return bool(np.nanmax(quantile(away, 0.98, axis=0)) > MOVES_M)
