"""What each offset between two views gains in agreement, over all offsets that leave a stretch in common."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np

from solver_backend.agreement.detections import MIN_POINTS
from solver_backend.cameras.camera_corrections import compared_pairs
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


MOST_PEOPLE = 4
"""People of a picture that are compared: the largest."""
_SAMPLES, _FEWEST_SAMPLES, _SAMPLED_PAIRS = 160, 40, 6
"""Frames of a view that are compared with all of another, and fewer of each where there are more pairs than this."""
_MOST_CELLS = 4_000_000
"""Comparisons of a pair that are held at once, 32 MB: of longer takes every second, third, ... frame is compared."""
NEIGHBOURS = 3
"""In arrays of more than 8 cameras each is compared with so many around on either side."""
EACH = 8
"""Cameras up to which each is paired with each; of more, with its neighbours; chosen by hand."""


PairTable = tuple[np.ndarray, np.ndarray, float]
"""Gains of a pair of views, what was possible, and how far most frames disagree."""


@dataclass(frozen=True)
class PairGains:
    """Gains of the pairs of C views at the offsets -(F-1) .. F-1, in frames that match.

    A frame's gain is how much less it disagrees with the one at an offset than with most frames of the other view, so
    that a view in which nothing moves gains nothing anywhere.
    """

    tables: dict[tuple[int, int], np.ndarray]
    """(2 F - 1,) for the pairs i < j: row ``o + F - 1`` where frame f of i goes with frame f + o of j."""
    possible: dict[tuple[int, int], np.ndarray]
    """(2 F - 1,) what would be gained if every frame in common matched exactly."""
    usual: dict[tuple[int, int], float]
    """How far most frames of a pair disagree, 0 to 1; 0 where it never sees anybody."""
    num_frames: int
    """F."""
    step: int
    """Frames between the offsets that were compared; those between have the gain of the nearest."""

    def profile(self, camera: int, others: dict[int, int]) -> np.ndarray:
        """Return (4 F - 3,) what offsets -2 (F-1) .. 2 (F-1) of a camera gain with others at their offsets."""
        reach = self.num_frames - 1
        total = np.zeros(4 * reach + 1)
        for other, offset in others.items():
            table = self.tables.get((other, camera))
            if table is None:
                table = self.tables[camera, other][::-1] if (camera, other) in self.tables else None
            if table is not None and abs(offset) <= reach:
                total[reach + offset : 3 * reach + offset + 1] += table
        return total

    def of_cameras(self, offsets: np.ndarray, among: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Return (C,) what each camera gains with all others, or those among (C,), and what was possible there."""
        reach = self.num_frames - 1
        gained, possible = np.zeros((2, len(offsets)))
        for (i, j), table in self.tables.items():
            row = int(offsets[j] - offsets[i]) + reach
            if among is not None and not (among[i] and among[j]):
                continue
            if 0 <= row <= 2 * reach:
                gained[[i, j]] += table[row]
                possible[[i, j]] += self.possible[i, j][row]
        return gained, possible


def pair_gains(
    cameras: Cameras,
    xy: np.ndarray,
    most_samples: int = _SAMPLES,
    names: Sequence[Hashable] = (),
    known: dict[Hashable, PairTable] | None = None,
) -> PairGains:
    """Return the gains of all pairs of views, those of neighbours in large arrays.

    Args:
        cameras: C cameras.
        xy: (C, F, P, J, 2) normalised points of everybody, NaN where missing.
        most_samples: frames of a view that are compared with all of another.
        names: one a camera; views of the same name show the same.
        known: tables of pairs of named views, taken from here and added to it.
    """
    views = people_of_views(xy)
    count, num_frames = len(views), xy.shape[1]
    pairs = compared_pairs(count, EACH, NEIGHBOURS)
    samples = int(np.clip(_SAMPLES * _SAMPLED_PAIRS // max(len(pairs), 1), _FEWEST_SAMPLES, _SAMPLES))
    samples = min(samples, most_samples)
    rows = [lively_frames(view, samples) for view in views]
    people = views[0].extent.shape[1]
    step = max(1, -(-samples * num_frames * people**2 // _MOST_CELLS))
    columns = np.arange(0, num_frames, step)
    thinned = [view.rows(columns) for view in views]
    tables, possible, usual = {}, {}, {}
    found: dict[Hashable, PairTable] = {} if known is None else known
    for i, j in pairs:
        key = (names[i], names[j], samples, num_frames) if names else (i, j)
        if key not in found:
            share = disagreements(cameras, i, j, views[i].rows(rows[i]), thinned[j])
            most = float(np.median(share[np.isfinite(share)])) if np.isfinite(share).any() else 0.0
            found[key] = (*_gains(share, rows[i], num_frames, step), most)
        tables[i, j], possible[i, j], usual[i, j] = found[key]
    return PairGains(tables, possible, usual, num_frames, step)


def people_of_views(xy: np.ndarray) -> list[ViewPeople]:
    """Return the largest people of each view of (C, F, P, J, 2) normalised points."""
    return [ViewPeople.of(_largest(view)) for view in xy]


def _gains(share: np.ndarray, rows: np.ndarray, num_frames: int, step: int) -> np.ndarray:
    """Return (2, 2 F - 1) gains, and what was possible, from (N, G) disagreements of N frames with each ``step``-th."""
    known = np.isfinite(share)
    usual = np.full(len(share), np.nan)
    seen = known.any(axis=1)
    whole = known.all(axis=1)  # most often: a median without a look at each value is many times as fast
    usual[whole] = np.median(share[whole], axis=1)
    usual[seen & ~whole] = np.nanmedian(share[seen & ~whole], axis=1)
    gain = np.stack([np.where(known, usual[:, None] - share, 0.0), np.where(known, usual[:, None], 0.0)])
    table = np.zeros((2, 2 * num_frames - 1))
    nearest = np.minimum((np.arange(num_frames) + step // 2) // step, gain.shape[-1] - 1)
    for row, frame in enumerate(rows):
        first = num_frames - 1 - frame
        table[:, first : first + num_frames] += gain[:, row, nearest]
    return table


def lively_frames(view: ViewPeople, count: int) -> np.ndarray:
    """Return numbers of frames spread over the take, of each stretch the one in which most moves."""
    points = np.where(view.seen[..., None] > 0, view.points[..., :2], np.nan)
    step = np.abs(np.diff(points, axis=0, prepend=points[:1])).sum(-1)
    speed = np.nan_to_num(step).sum(axis=(1, 2)) + 1e-9 * view.seen.sum(axis=(1, 2))
    parts = np.array_split(np.arange(len(speed)), min(count, len(speed)))
    return np.array([part[np.argmax(speed[part])] for part in parts])


def _largest(xy: np.ndarray) -> np.ndarray:
    """Return (F, P, J, 2) the largest people of each frame, at most ``MOST_PEOPLE``."""
    if xy.shape[1] <= MOST_PEOPLE:
        return xy
    extent = ViewPeople.of(xy).extent
    order = np.argsort(np.where(np.isfinite(extent), -extent, 0.0), axis=1, kind="stable")[:, :MOST_PEOPLE]
    return np.take_along_axis(xy, order[..., None, None], axis=1)
