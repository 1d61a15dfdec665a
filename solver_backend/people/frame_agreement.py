"""How well any frame of one view agrees with any frame of another, by epipolar lines, in large matrix products."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.people.sightings import MIN_POINTS
from solver_backend.types import Cameras

OFF_LINE = 0.04
"""Scale of the Geman-McClure penalty of the distance of a person's keypoints to their epipolar lines, in the person's
extent: 6 cm of a person, twice what detectors and calibrations err by."""


@dataclass(frozen=True)
class ViewPeople:
    """People of one view as the products take them."""

    points: np.ndarray
    """(F, P, J, 3) normalised points, homogeneous, 0 where unseen."""
    seen: np.ndarray
    """(F, P, J) 1 where a point is seen, else 0."""
    extent: np.ndarray
    """(F, P) diagonal of the person's box in normalised coordinates; inf where too few points are seen."""

    @classmethod
    def of(cls, xy: np.ndarray) -> ViewPeople:
        """Return what (F, P, J, 2) normalised points show, NaN where missing."""
        known = np.isfinite(xy[..., 0]) & (np.isfinite(xy[..., 0]).sum(-1) >= MIN_POINTS)[..., None]
        low = np.where(known[..., None], xy, np.inf).min(-2)
        high = np.where(known[..., None], xy, -np.inf).max(-2)
        with np.errstate(invalid="ignore"):
            size = np.hypot(*np.moveaxis(high - low, -1, 0))
        filled = np.where(known[..., None], xy, 0.0)
        points = np.concatenate([filled, known[..., None]], axis=-1)
        return cls(points, known.astype(float), np.where(known.any(-1) & (size > 0), size, np.inf))

    def rows(self, frames: np.ndarray) -> ViewPeople:
        """Return these frames."""
        return ViewPeople(self.points[frames], self.seen[frames], self.extent[frames])


def disagreements(cameras: Cameras, i: int, j: int, a: ViewPeople, b: ViewPeople) -> np.ndarray:
    """Return (N, G) how far people of frames of view i are from anybody in frames of view j, 0 to 1, NaN if unknown.

    With lines ``l = E x_a / |(E x_a)₁₂|`` the squared distance ``(x_bᵀ l)²`` is a product of the six numbers of
    ``l lᵀ`` and of ``x_b x_bᵀ``: its sums over the keypoints of all pairs of frames are one matrix product, and another
    the other way. Of each person of view i the best of view j counts, by ``d²/(d² + s²)``.

    Args:
        cameras: C cameras.
        i: index of the first view.
        j: index of the second.
        a: people in N frames of the first.
        b: people in G frames of the second.

    Reference: Hartley and Zisserman 2004, "Multiple View Geometry", sec. 9.6 and 11.4.
    """
    E = _essential(cameras, i, j)
    (n, p), (g, q) = a.extent.shape, b.extent.shape
    forth = _squares(_lines(a.points, E.T)).reshape(n * p, -1) @ _squares(_scaled(b)).reshape(g * q, -1).T
    back = _squares(_scaled(a)).reshape(n * p, -1) @ _squares(_lines(b.points, E)).reshape(g * q, -1).T
    common = a.seen.reshape(n * p, -1) @ b.seen.reshape(g * q, -1).T
    share = _shares(forth + back, common, OFF_LINE).reshape(n, p, g, q)
    return _means(share.min(-1), axis=1)


def moment_disagreements(cameras: Cameras, i: int, j: int, a: ViewPeople, b: ViewPeople, off_line: float) -> np.ndarray:
    """Return (N,) the same of N moments: row n of one view with row n of the other.

    Args: those of ``disagreements``, with N = G frames in both, and
        off_line: scale of the penalty, in the person's extent.
    """
    E = _essential(cameras, i, j)
    products = (
        (_squares(_lines(a.points, E.T)), _squares(_scaled(b))), (_squares(_scaled(a)), _squares(_lines(b.points, E))),
    )  # fmt: skip
    square = sum(_by_moment(one) @ np.swapaxes(_by_moment(other), -1, -2) for one, other in products)
    common = _by_moment(a.seen[..., None]) @ np.swapaxes(_by_moment(b.seen[..., None]), -1, -2)
    return _means(_shares(np.asarray(square), common, off_line).min(-1), axis=1)


def _essential(cameras: Cameras, i: int, j: int) -> np.ndarray:
    """Return E (3, 3) with ``x_jᵀ E x_i = 0``."""
    R = cameras.R[j] @ cameras.R[i].T
    x, y, z = cameras.t[j] - R @ cameras.t[i]
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) @ R


def _shares(both: np.ndarray, common: np.ndarray, off_line: float) -> np.ndarray:
    """Return ``d²/(d² + s²)`` of summed squares of both ways, which are overwritten, over so many common points.

    It is inf where these are few.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        both *= 0.5
        both /= common
        both /= both + off_line**2
    both[common < MIN_POINTS] = np.inf
    return both


def _means(nearest: np.ndarray, axis: int) -> np.ndarray:
    """Return means over the people who are seen in both, NaN where nobody is."""
    known = np.isfinite(nearest)
    with np.errstate(invalid="ignore"):
        return np.where(known, nearest, 0.0).sum(axis) / np.where(known.any(axis), known.sum(axis), np.nan)


def _by_moment(values: np.ndarray) -> np.ndarray:
    return values.reshape(*values.shape[:2], -1)


def _lines(points: np.ndarray, E: np.ndarray) -> np.ndarray:
    """Return (F, P, J, 3) lines in the other view, 0 for unseen points."""
    line = points @ E
    return line / np.maximum(np.linalg.norm(line[..., :2], axis=-1, keepdims=True), 1e-12)


def _scaled(people: ViewPeople) -> np.ndarray:
    return people.points / people.extent[..., None, None]


def _squares(vectors: np.ndarray) -> np.ndarray:
    """Return (F, P, J, 6) the six numbers of each ``v vᵀ``; products of two of them sum to ``(vᵀ w)²``."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    root = np.sqrt(2.0)
    return np.stack([x * x, y * y, z * z, root * x * y, root * x * z, root * y * z], axis=-1)
