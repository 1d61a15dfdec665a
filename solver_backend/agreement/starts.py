"""Find how many frames apart cameras started, by the epipolar lines of the people in their views.

A table per pair of views holds how well they agree at every offset. The offsets of all cameras are those of the largest
sum over the pairs. They are a finding only if they beat "in step" and every other offset with a margin.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum
from itertools import combinations, product

import numpy as np

from solver_backend.agreement.detections import MIN_POINTS, Detections, sightings
from solver_backend.agreement.reading import PictureReading, Reading, apply_reading
from solver_backend.cameras.camera_corrections import FACTORS, POSES, TURNS, compared_pairs
from solver_backend.cameras.projection import undistort
from solver_backend.exchange.progress import Progress, silent
from solver_backend.types import UNSEEN_POINT, Cameras

STAGE = "Comparing the clocks"  # Name of the comparison in progress reports.
COARSE, FINE = 0.04, 0.015
"""Scales of the Geman-McClure penalty of a distance from an epipolar line, in the person's extent: 6 and 2 cm."""
REACH = 4  # Frames on either side that are refined.
EACH, NEIGHBOURS = 8, 3  # Cameras up to which each is paired with each. In larger arrays, neighbours on either side.
MOST_PEOPLE = 4  # People of a picture that are compared: the largest.
SAMPLES, FEWEST_SAMPLES, SAMPLED_PAIRS, FINE_SAMPLES = 160, 40, 6, 400
"""Frames of a view that are compared with all of another, and fewer of each if there are more pairs than this. Frames
of the refinement."""
MOST_CELLS = 4_000_000
"""Comparisons of a pair that are held at once, 32 MB: of longer takes every second, third, ... frame is compared."""
LEAST_STRENGTH = 3.0
"""Frames that must match per camera, times the square of the share that could match: simulated cameras in step reach 10
to 60, real ones with a poor calibration 5 to 20, unrelated cameras up to 1.9."""
RIVAL_SHARE = 0.7  # Share of the gain from which another offset leaves open which is right, as with periodic movement.
NEAR_S = 0.35  # Offsets so near to the best are the same finding; a period of walking is longer.
KEPT_SHARE = 0.8  # Cameras stay as numbered if that gains so much of the best.
COMMON_SHARE = 0.5  # Share of the shortest recording that all cameras must have in common, else two of them.
FEW_ROWS = 300  # Frames of each view that are looked at to compare readings.
LEAST_READING, READING_RIVAL, NEAR_SIZE = 1.0, 0.6, 0.5
"""Least strength of another reading on few frames, share of it that leaves open which is right, and difference of
logarithms up to which sizes are neighbours."""
_ROUNDS = 8  # Rounds of descent at most, chosen by hand.


@dataclass(frozen=True)
class ViewPeople:
    """People in F frames of a view."""

    points: np.ndarray
    """(F, P, J, 3) normalised points, homogeneous, 0 where unseen."""
    seen: np.ndarray
    """(F, P, J) 1 where a point is seen, else 0."""
    extent: np.ndarray
    """(F, P) diagonal of the person's box in normalised coordinates. Infinite if too few points are seen."""

    @classmethod
    def of(cls, xy: np.ndarray) -> ViewPeople:
        """Return the people of (F, P, J, 2) normalised points, NaN where missing."""
        known = np.isfinite(xy[..., 0]) & (np.isfinite(xy[..., 0]).sum(-1) >= MIN_POINTS)[..., None]
        low = np.where(known[..., None], xy, np.inf).min(-2)
        high = np.where(known[..., None], xy, -np.inf).max(-2)
        with np.errstate(invalid="ignore"):
            size = np.hypot(*np.moveaxis(high - low, -1, 0))
        points = np.concatenate([np.where(known[..., None], xy, 0.0), known[..., None]], axis=-1)
        return cls(points, known.astype(float), np.where(known.any(-1) & (size > 0), size, np.inf))

    def rows(self, frames: np.ndarray) -> ViewPeople:
        """Return these frames."""
        return ViewPeople(self.points[frames], self.seen[frames], self.extent[frames])

    def lively_frames(self, count: int) -> np.ndarray:
        """Return frames spread over the take, from each part the one in which most moves."""
        points = np.where(self.seen[..., None] > 0, self.points[..., :2], np.nan)
        step = np.abs(np.diff(points, axis=0, prepend=points[:1])).sum(-1)
        speed = np.nan_to_num(step).sum(axis=(1, 2)) + 1e-9 * self.seen.sum(axis=(1, 2))
        parts = np.array_split(np.arange(len(speed)), min(count, len(speed)))
        return np.array([part[np.argmax(speed[part])] for part in parts])


def people_of_views(xy: np.ndarray) -> list[ViewPeople]:
    """Return the largest people of each view of (C, F, P, J, 2) normalised points."""
    if xy.shape[2] > MOST_PEOPLE:
        extent = np.stack([ViewPeople.of(view).extent for view in xy])
        order = np.argsort(np.where(np.isfinite(extent), -extent, 0.0), axis=2, kind="stable")[..., :MOST_PEOPLE]
        xy = np.take_along_axis(xy, order[..., None, None], axis=2)
    return [ViewPeople.of(view) for view in xy]


def disagreements(
    cameras: Cameras, pair: tuple[int, int], a: ViewPeople, b: ViewPeople, scale: float, *, by_row: bool = False
) -> np.ndarray:
    """Return (N, G) how far the people in frames of one view are from anybody in frames of another, 0 to 1.

    With lines ``l = E x_a / |(E x_a)_12|`` the squared distance ``(x_b' l)^2`` is a product of the six numbers of
    ``l l'`` and of ``x_b x_b'``. Its sums over the keypoints of all pairs of frames are one matrix product. The best
    person of the second view counts, by ``d^2 / (d^2 + scale^2)``. NaN if nobody is seen in both.

    Args:
        cameras: C cameras.
        pair: indices of the views.
        a: people in N frames of the first.
        b: people in G frames of the second.
        scale: of the penalty, in the person's extent.
        by_row: compare row n with row n alone and return (N,).

    Reference: Hartley and Zisserman 2004, "Multiple View Geometry", sec. 9.6 and 11.4.
    """
    i, j = pair
    R = cameras.R[j] @ cameras.R[i].T
    x, y, z = cameras.t[j] - R @ cameras.t[i]
    E = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) @ R
    factors = [
        (_squares(_lines(a.points, E.T)), _squares(b.points / b.extent[..., None, None])),
        (_squares(a.points / a.extent[..., None, None]), _squares(_lines(b.points, E))),
        (a.seen[..., None], b.seen[..., None]),
    ]
    (n, p), (g, q) = a.extent.shape, b.extent.shape
    if by_row:
        forth, back, common = (one.reshape(n, p, -1) @ np.swapaxes(two.reshape(n, q, -1), 1, 2) for one, two in factors)
    else:
        forth, back, common = (one.reshape(n * p, -1) @ two.reshape(g * q, -1).T for one, two in factors)
    share = forth
    share += back
    with np.errstate(invalid="ignore", divide="ignore"):
        share *= 0.5
        share /= common
        share /= share + scale**2
    share[common < MIN_POINTS] = np.inf
    nearest = share.min(-1) if by_row else share.reshape(n, p, g, q).min(-1)
    known = np.isfinite(nearest)
    with np.errstate(invalid="ignore"):
        return np.where(known, nearest, 0.0).sum(1) / np.where(known.any(1), known.sum(1), np.nan)


def _lines(points: np.ndarray, E: np.ndarray) -> np.ndarray:
    line = points @ E
    return line / np.maximum(np.linalg.norm(line[..., :2], axis=-1, keepdims=True), 1e-12)


def _squares(vectors: np.ndarray) -> np.ndarray:
    """Return (F, P, J, 6) the six numbers of each ``v v'``; products of two of them sum to ``(v' w)^2``."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    root = np.sqrt(2.0)
    return np.stack([x * x, y * y, z * z, root * x * y, root * x * z, root * y * z], axis=-1)


@dataclass(frozen=True)
class PairGains:
    """Gains of the pairs of C views at the offsets -(F-1) .. F-1, in frames that match.

    A frame's gain is how much less it disagrees with the one at an offset than with most frames of the other view. A
    view in which nothing moves gains nothing.
    """

    tables: dict[tuple[int, int], np.ndarray]
    """(2, 2 F - 1) gain and possible gain of pairs i < j. Column ``o + F - 1``: frame f of i is frame f + o of j."""
    num_frames: int
    """F."""
    step: int
    """Frames between compared offsets. Those between have the gain of the nearest."""

    def profile(self, camera: int, others: dict[int, int]) -> np.ndarray:
        """Return (4 F - 3,) the gain of a camera at offsets -2 (F-1) .. 2 (F-1) with others at their offsets."""
        reach = self.num_frames - 1
        total = np.zeros(4 * reach + 1)
        for other, offset in others.items():
            pair = min(camera, other), max(camera, other)
            if pair in self.tables and abs(offset) <= reach:
                table = self.tables[pair][0]
                total[reach + offset : 3 * reach + offset + 1] += table if other < camera else table[::-1]
        return total

    def of_cameras(self, offsets: np.ndarray, among: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Return (C,) gains of each camera with all others, or those ``among`` (C,), and the possible gains."""
        reach, found = self.num_frames - 1, np.zeros((2, len(offsets)))
        for (i, j), table in self.tables.items():
            row = int(offsets[j] - offsets[i]) + reach
            if 0 <= row <= 2 * reach and (among is None or (among[i] and among[j])):
                found[:, [i, j]] += table[:, row, None]
        return found[0], found[1]

    def best_offsets(self, count: int) -> np.ndarray:
        """Return (C,) offsets against the first camera of the largest gain.

        They are grown from the pair that agrees best, then improved by descent along one camera after the other (Besag
        1986).
        """
        i, j = max(self.tables, key=lambda pair: self.tables[pair][0].max())
        placed = {i: 0, j: int(self.tables[i, j][0].argmax()) - (self.num_frames - 1)}
        reach = 2 * (self.num_frames - 1)
        while len(placed) < count:
            profiles = {c: self.profile(c, placed) for c in range(count) if c not in placed}
            c = max(profiles, key=lambda c: profiles[c].max())
            placed[c] = int(profiles[c].argmax()) - reach
        for _ in range(_ROUNDS):
            before = dict(placed)
            for c in range(count):
                others = {o: at for o, at in placed.items() if o != c}
                placed[c] = int(self.profile(c, others).argmax()) - reach
            if placed == before:
                break
        offsets = np.array([placed[c] for c in range(count)])
        return offsets - offsets[0]


def pair_gains(
    cameras: Cameras, xy: np.ndarray, most_samples: int = SAMPLES, reach: int | None = None, progress: Progress = silent
) -> PairGains:
    """Return the gains of all pairs of views, those of neighbours in large arrays.

    Args:
        cameras: C cameras.
        xy: (C, F, P, J, 2) normalised points of all people, NaN where missing.
        most_samples: frames of a view that are compared with all of another.
        reach: largest offset, every one if None.
        progress: called for each pair of views.
    """
    views, num_frames = people_of_views(xy), xy.shape[1]
    pairs = compared_pairs(len(views), EACH, NEIGHBOURS)
    samples = int(np.clip(SAMPLES * SAMPLED_PAIRS // max(len(pairs), 1), FEWEST_SAMPLES, SAMPLES))
    samples = min(samples, most_samples)
    rows = [view.lively_frames(samples) for view in views]
    step = max(1, -(-samples * num_frames * views[0].extent.shape[1] ** 2 // MOST_CELLS))
    thinned = [view.rows(np.arange(0, num_frames, step)) for view in views]
    beyond = np.abs(np.arange(1 - num_frames, num_frames)) > (num_frames if reach is None else reach)
    tables = dict[tuple[int, int], np.ndarray]()
    for number, (i, j) in enumerate(pairs):
        progress(STAGE, number, len(pairs))
        share = disagreements(cameras, (i, j), views[i].rows(rows[i]), thinned[j], COARSE)
        tables[i, j] = _gains(share, rows[i], num_frames, step)
        tables[i, j][:, beyond] = 0.0
    return PairGains(tables, num_frames, step)


def _gains(share: np.ndarray, rows: np.ndarray, num_frames: int, step: int) -> np.ndarray:
    """Return (2, 2 F - 1) gains and possible gains from (N, G) disagreements of N frames with each ``step``-th."""
    known = np.isfinite(share)
    usual, seen, whole = np.full(len(share), np.nan), known.any(axis=1), known.all(axis=1)
    usual[whole] = np.median(share[whole], axis=1)  # many times as fast as the other one
    usual[seen & ~whole] = np.nanmedian(share[seen & ~whole], axis=1)
    gain = np.stack([np.where(known, usual[:, None] - share, 0.0), np.where(known, usual[:, None], 0.0)])
    table = np.zeros((2, 2 * num_frames - 1))
    nearest = np.minimum((np.arange(num_frames) + step // 2) // step, gain.shape[-1] - 1)
    for row, frame in enumerate(rows):
        first = num_frames - 1 - frame
        table[:, first : first + num_frames] += gain[:, row, nearest]
    return table


def refine_starts(cameras: Cameras, xy: np.ndarray, offsets: np.ndarray, reach: int = REACH) -> np.ndarray:
    """Return the offsets nearby at which the views agree best, by descent along one camera after the other.

    Args:
        cameras: C cameras.
        xy: (C, F, P, J, 2) normalised points, NaN where missing.
        offsets: (C,) frames, see ``find_starts``. The first stays.
        reach: frames on either side that are tried.
    """
    views = people_of_views(xy)
    changes, tried = np.arange(-2 * reach, 2 * reach + 1), np.arange(-reach, reach + 1)
    costs = dict[tuple[int, int], np.ndarray]()
    for i, j in compared_pairs(len(views), EACH, NEIGHBOURS):
        at = views[i].lively_frames(FINE_SAMPLES)[:, None] + int(offsets[j] - offsets[i]) + changes
        at = at[((at >= 0) & (at < len(views[j].extent))).all(axis=1)]
        first = views[i].rows(at[:, 2 * reach] - int(offsets[j] - offsets[i]))
        shares = np.stack([
            disagreements(cameras, (i, j), first, views[j].rows(rows), FINE, by_row=True) for rows in at.T
        ])  # fmt: skip
        costs[i, j] = shares[:, np.isfinite(shares).all(axis=0)].sum(axis=1)
    moved = np.zeros(len(views), int)
    for _ in range(_ROUNDS):
        before = moved.copy()
        for c in range(1, len(views)):
            total = np.zeros(len(tried))
            for (i, j), cost in costs.items():
                if c in (i, j):
                    between = tried - moved[i] if c == j else moved[j] - tried
                    total += cost[np.clip(between + 2 * reach, 0, 4 * reach)]
            moved[c] = tried[total.argmin()]
        if (moved == before).all():
            break
    return offsets + moved


def whole_lags(cameras: Cameras, tracks: np.ndarray, reach: int, progress: Progress = silent) -> np.ndarray:
    """Return (C,) whole frames by which cameras lag behind the first; zeros unless others agree far better.

    Args:
        cameras: C cameras.
        tracks: (C, F, K, 2) px, NaN where missing. Several people count as one.
        reach: largest lag between two cameras, frames.
        progress: called for each pair of views.
    """
    xy, none = undistort(cameras, tracks)[:, :, None], np.zeros(len(cameras), int)
    gains = pair_gains(cameras, xy, reach=reach, progress=progress)
    best = gains.best_offsets(len(cameras))
    (now, _), (then, _) = gains.of_cameras(none), gains.of_cameras(best)
    if (now >= KEPT_SHARE * then).all() or (strengths(gains, best) < LEAST_STRENGTH).any():
        return none
    return refine_starts(cameras, xy, best, REACH + gains.step)


class StartEvidence(Enum):
    """What is known of when cameras started."""

    IN_STEP = "in step"  # They agree by their numbers, or better nowhere with a margin.
    APART = "apart"  # They agree far better at other offsets, and only there.
    STILL = "still"  # Unknown: too little moves, or too little is seen by two cameras.
    AMBIGUOUS = "ambiguous"  # They agree equally at several offsets, and less as numbered.


@dataclass(frozen=True)
class CameraStarts:
    """The row of each of C cameras that shows the moment of the take's row 0."""

    offsets: np.ndarray  # (C,) whole frames. Frame f of the take is row f + offset of the camera.
    evidence: StartEvidence  # Their evidence. Unless it is ``APART``, the offsets are those as numbered.
    doubtful: tuple[int, ...] = ()  # Cameras that show nothing; of ``AMBIGUOUS`` those that agree at several offsets.
    rivals: tuple[int, int] = (0, 0)  # The two best offsets of the first of these against the first camera.


def find_starts(cameras: Cameras, detections: Detections, fps: float, numbered: np.ndarray) -> CameraStarts:
    """Return how many frames apart cameras started. No camera, and no two, may gain nearly as much elsewhere.

    Args:
        cameras: C calibrated cameras.
        detections: all people; row 0 of a camera is the first frame that it recorded.
        fps: frames per second.
        numbered: (C,) offsets by the numbers of the frames.
    """
    seeing = np.flatnonzero(detections.people().any(axis=1))
    if len(seeing) < 2:
        return CameraStarts(numbered, StartEvidence.STILL, tuple(range(len(cameras))))
    names = tuple(cameras.names[c] for c in seeing)
    part = Detections(names, detections.xy[seeing], detections.confidence[seeing], detections.joint_set)
    seen = sightings(cameras.subset(seeing.tolist()), part)
    gains = pair_gains(seen.cameras, seen.xy)
    found = _judge(gains, numbered[seeing], max(round(NEAR_S * fps), gains.step))
    offsets = numbered.copy()
    offsets[seeing] = found.offsets
    if found.evidence is StartEvidence.APART:
        sure = np.setdiff1d(np.arange(len(seeing)), found.doubtful)
        kept = seen.cameras.subset(sure.tolist())
        offsets[seeing[sure]] = refine_starts(kept, seen.xy[sure], found.offsets[sure], REACH + gains.step)
    return CameraStarts(offsets, found.evidence, tuple(int(seeing[c]) for c in found.doubtful), found.rivals)


def _judge(gains: PairGains, numbered: np.ndarray, near: int) -> CameraStarts:
    best = gains.best_offsets(len(numbered))
    sure = strengths(gains, best) >= LEAST_STRENGTH
    doubtful = tuple(np.flatnonzero(~sure).tolist())
    if sure.sum() < 2:
        return CameraStarts(numbered, StartEvidence.STILL, tuple(range(len(numbered))))
    (now, _), (then, _) = gains.of_cameras(numbered, sure), gains.of_cameras(best, sure)
    if (now >= KEPT_SHARE * then)[sure].all():
        return CameraStarts(numbered, StartEvidence.STILL if doubtful else StartEvidence.IN_STEP, doubtful)
    if open_ := _rivals(gains, best, np.flatnonzero(sure), near):
        return CameraStarts(numbered, StartEvidence.AMBIGUOUS, tuple(open_), next(iter(open_.values())))
    return CameraStarts(np.where(sure, best, numbered), StartEvidence.APART, doubtful)


def strengths(gains: PairGains, offsets: np.ndarray) -> np.ndarray:
    """Return (C,) frames of each camera that match at offsets, times the square of the share that could."""
    gained, possible = gains.of_cameras(offsets)
    return gained * (gained / np.maximum(possible, 1e-9)) ** 2


def _rivals(gains: PairGains, best: np.ndarray, sure: np.ndarray, near: int) -> dict[int, tuple[int, int]]:
    """Return the two best offsets, against the first camera, of each camera that has a rival elsewhere.

    Cameras move alone and by twos: two that see each other's side may agree with the other two at several offsets.
    """
    reach = 2 * (gains.num_frames - 1)
    changes = np.arange(-reach, reach + 1)
    found: dict[int, tuple[int, int]] = {}
    alone = [(int(c),) for c in sure]
    for group in alone + list(combinations(sure.tolist(), 2)) * (len(sure) > 3):
        others = {int(o): int(best[o]) for o in sure if o not in group}
        total = np.zeros(len(changes))
        for c in group:
            rows = changes + reach + int(best[c])
            inside = (rows >= 0) & (rows <= 2 * reach)
            total += np.where(inside, gains.profile(c, others)[np.clip(rows, 0, 2 * reach)], 0.0)
        rival = int(np.where(np.abs(changes) > near, total, -np.inf).argmax())
        if total[rival] > RIVAL_SHARE * total[reach]:
            shown = group[0] if group[0] else next(iter(others))
            change = int(changes[rival]) * (1 if group[0] else -1)
            found.setdefault(shown, (int(best[shown]), int(best[shown]) + change))
    return found


def matches(cameras: Cameras, detections: Detections) -> tuple[np.ndarray, np.ndarray]:
    """Return (C,) gains of each camera at the best offsets, and the possible gains, on few frames.

    Args:
        cameras: C cameras.
        detections: all people, each camera from its own first frame.
    """
    step = max(1, -(-detections.num_frames // FEW_ROWS))
    thin = replace(detections, xy=detections.xy[:, ::step], confidence=detections.confidence[:, ::step], hands=None)
    gains = pair_gains(cameras, sightings(cameras, thin).xy, FEWEST_SAMPLES)
    return gains.of_cameras(gains.best_offsets(len(cameras)))


def read_out_of_step(cameras: Cameras, detections: Detections) -> Reading | None:
    """Return the reading of all cameras under which they match at some offsets, None if none is clearly the best.

    Args:
        cameras: C cameras as written.
        detections: all people, each camera from its own first frame.
    """
    count, written = len(cameras), Reading.as_written(len(cameras))
    if not 2 <= count <= EACH or not (detections.people() > 0).any(axis=1).all():
        return None
    kinds = [PictureReading(size, turn) for size, turn in product(FACTORS, TURNS)]
    readings = [replace(written, pictures=(kind,) * count) for kind in kinds]
    readings += [replace(written, pose=pose, graphics=axes) for pose, axes in product(POSES, (False, True))]
    strength = dict[Reading, float]()
    for reading in dict.fromkeys(readings):
        gained, possible = matches(*apply_reading(cameras, detections, reading))
        strength[reading] = float(np.median(gained * (gained / np.maximum(possible, 1e-9)) ** 2))
    best = max(strength, key=lambda reading: strength[reading])
    rivals = [strength[reading] for reading in strength if _differ(reading, best)]
    clear = strength[best] >= LEAST_READING and max(rivals) < READING_RIVAL * strength[best]
    return best if clear and best != written else None


def _differ(one: Reading, other: Reading) -> bool:
    """Return whether readings differ in more than neighbouring sizes, which gain about the same."""
    kinds = [(r.pose, r.graphics, r.pictures[0].turn, r == Reading.as_written(len(r.owners))) for r in (one, other)]
    return kinds[0] != kinds[1] or abs(np.log(one.pictures[0].size / other.pictures[0].size)) > NEAR_SIZE


def common_rows(offsets: np.ndarray, lengths: np.ndarray, *, every: bool = False) -> tuple[int, int]:
    """Return the first row of the take, and one past its last, on the first camera's clock.

    Args:
        offsets: (C,) frame f of the take is row f + offset of a camera.
        lengths: (C,) rows that cameras recorded. Cameras without any are ignored.
        every: the rows that all cameras recorded, however few.
    """
    recorded = lengths > 0
    first, stop = -offsets[recorded], (lengths - offsets)[recorded]
    low, high = int(first.max()), int(stop.min())
    if every or high - low >= COMMON_SHARE * lengths[recorded].min():
        return low, high
    # By two cameras: from the second start to the last end but one.
    moments = np.arange(int(first.min()), int(stop.max()))
    several = ((moments[:, None] >= first) & (moments[:, None] < stop)).sum(1) >= min(2, len(first))
    return (int(moments[several][0]), int(moments[several][-1]) + 1) if several.any() else (0, 0)


def align_rows(detections: Detections, offsets: np.ndarray, first: int, stop: int) -> Detections:
    """Return rows ``first`` to ``stop - 1`` of the take. Nobody is seen where a camera did not record.

    Args:
        detections: C cameras on their own clocks.
        offsets: (C,) see ``common_rows``.
        first: row of the take that comes first.
        stop: one past the last.
    """
    rows = np.arange(first, stop) + offsets[:, None]
    inside = (rows >= 0) & (rows < detections.num_frames)
    rows = np.clip(rows, 0, max(detections.num_frames - 1, 0))
    views = np.arange(len(rows))[:, None]
    xy, confidence = detections.xy[views, rows], detections.confidence[views, rows]
    xy[~inside], confidence[~inside] = np.nan, 0.0
    hands = None if detections.hands is None else detections.hands[views, rows]
    if hands is not None:
        hands[~inside] = UNSEEN_POINT
    return replace(detections, xy=xy, confidence=confidence, hands=hands)
