"""Estimate each camera's start frame from the epipolar lines of people.

A table per pair of views has their agreement at every offset. The best offsets maximise the sum over the pairs. They
are accepted only if they beat the offsets of the frame numbers and all alternatives by a margin.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from itertools import combinations, product

import numpy as np

from solver_backend.agreement.evidence import (
    BOUND,
    EACH,
    MOST_ROUNDS,
    MOVED,
    NEIGHBOURS,
    SAMPLED_FRAMES,
    STRIDE,
    TakeEvidence,
)
from solver_backend.agreement.evidence import POSES as FEWEST_SAMPLES
from solver_backend.agreement.person_tracks import STEP_SHARE
from solver_backend.agreement.reading import (
    MIN_POINTS,
    Detections,
    PictureReading,
    Reading,
    apply_reading,
    extent,
    sightings,
)
from solver_backend.cameras.camera_corrections import FACTORS, POSES, TURNS, compared_pairs
from solver_backend.geometry.rotations import skew
from solver_backend.types import UNSEEN_POINT, Cameras

STAGE = "Comparing the clocks"  # Name of this stage in progress reports.
FINE = 0.015  # Geman-McClure scale of the epipolar distance for refinement, in person sizes: 2 cm.
MOST_PEOPLE = 4  # Number of the largest people in an image to compare.
SAMPLES, SAMPLED_PAIRS = 160, 6
"""Frames per view to compare with all frames of another view, and number of pairs from which they are fewer."""
MOST_CELLS = 4_000_000
"""Comparisons of a pair in memory at once, 32 MB. For longer takes every second, third, ... frame is compared."""
LEAST_STRENGTH = 3.0
"""Smallest number of matching frames per camera, times the square of their share. Simulated synchronised cameras reach
10 to 60, real ones with a poor calibration 5 to 20, unrelated cameras up to 1.9."""
RIVAL_SHARE = 0.7
"""Smallest share of the best gain with which frame numbers win, and with which another offset, rate or interpretation
counts as an alternative.
"""
NEAR_S = 0.35  # Offsets closer to the best one count as the same result. The period of walking is longer.
LEAST_READING = 1.0  # Smallest strength of an interpretation.
NEAR_SIZE = 0.5  # Sizes with a smaller difference of logarithms are neighbours and have similar gains.


@dataclass(frozen=True)
class _ViewPeople:
    """People of one view in F frames."""

    points: np.ndarray  # (F, P, J, 3) normalised points, homogeneous, 0 where unseen.
    extent: np.ndarray  # (F, P) diagonal of the person's box. Infinite if too few points are seen.

    @classmethod
    def of(cls, xy: np.ndarray) -> _ViewPeople:
        """Return the largest people of (F, P, J, 2) normalised points, NaN where missing."""
        known = np.isfinite(xy[..., 0]) & (np.isfinite(xy[..., 0]).sum(-1) >= MIN_POINTS)[..., None]
        size = extent(np.where(known[..., None], xy, np.nan))
        largest = np.argsort(-np.nan_to_num(size), axis=1, kind="stable")[:, :MOST_PEOPLE]
        points = np.concatenate([np.where(known[..., None], xy, 0.0), known[..., None]], axis=-1)
        size = np.take_along_axis(np.where(size > 0, size, np.inf), largest, 1)
        return cls(np.take_along_axis(points, largest[..., None, None], 1), size)

    def rows(self, frames: np.ndarray) -> _ViewPeople:
        return _ViewPeople(self.points[frames], self.extent[frames])

    def lively_frames(self, count: int) -> np.ndarray:
        """Return the frame with the most movement in each of ``count`` sections of the take."""
        seen = self.points[..., 2]
        points = np.where(seen[..., None] > 0, self.points[..., :2], np.nan)
        step = np.abs(np.diff(points, axis=0, prepend=points[:1])).sum(-1)
        speed = np.nan_to_num(step).sum(axis=(1, 2)) + 1e-9 * seen.sum(axis=(1, 2))
        parts = np.array_split(np.arange(len(speed)), min(count, len(speed)))
        return np.array([part[np.argmax(speed[part])] for part in parts])


def _disagreements(cameras: Cameras, pair: tuple[int, int], a: _ViewPeople, b: _ViewPeople, scale: float) -> np.ndarray:
    """Return (N, G) distances from 0 to 1 between people in two views, or NaN.

    With lines ``l = E x_a / |(E x_a)_12|`` the squared distance ``(x_b' l)^2`` is a product of the six numbers of ``l
    l'`` and of ``x_b x_b'``. Its sum over the keypoints for all pairs of frames is one matrix product (Hartley and
    Zisserman 2004, sec. 9.6 and 11.4). Only the best person of the second view counts.
    """
    i, j = pair
    R = cameras.R[j] @ cameras.R[i].T
    E = skew(cameras.t[j] - R @ cameras.t[i]) @ R
    factors = [
        (_squares(_lines(a.points, E.T)), _squares(b.points / b.extent[..., None, None])),
        (_squares(a.points / a.extent[..., None, None]), _squares(_lines(b.points, E))),
        (a.points[..., 2:], b.points[..., 2:]),
    ]
    (n, p), (g, q) = a.extent.shape, b.extent.shape
    share, back, common = (one.reshape(n * p, -1) @ two.reshape(g * q, -1).T for one, two in factors)
    share += back
    with np.errstate(invalid="ignore", divide="ignore"):
        share *= 0.5
        share /= common
        share /= share + scale**2
    share[common < MIN_POINTS] = np.inf
    nearest = share.reshape(n, p, g, q).min(-1)
    known = np.isfinite(nearest)
    with np.errstate(invalid="ignore"):
        return np.where(known, nearest, 0.0).sum(1) / np.where(known.any(1), known.sum(1), np.nan)


def _lines(points: np.ndarray, E: np.ndarray) -> np.ndarray:
    line = points @ E
    return line / np.maximum(np.linalg.norm(line[..., :2], axis=-1, keepdims=True), 1e-12)


def _squares(vectors: np.ndarray) -> np.ndarray:
    """Return (F, P, J, 6) entries of ``v v'``. The dot product of two such rows is ``(v' w)^2``."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    root = np.sqrt(2.0)
    return np.stack([x * x, y * y, z * z, root * x * y, root * x * z, root * y * z], axis=-1)


Tables = dict[tuple[int, int], np.ndarray]
"""(2 R + 1,) gains of pairs of views i < j at offsets -R to R of j relative to i."""


def offset_profile(tables: Tables, camera: int, others: dict[int, int]) -> np.ndarray:
    """Return the (4 R + 1,) gains of a camera at offsets from -2 R to 2 R."""
    reach = len(next(iter(tables.values()))) // 2
    total = np.zeros(4 * reach + 1)
    for other, offset in others.items():
        pair = min(camera, other), max(camera, other)
        if pair in tables and abs(offset) <= reach:
            table = tables[pair]
            total[reach + offset : 3 * reach + offset + 1] += table if other < camera else table[::-1]
    return total


def best_offsets(tables: Tables, count: int) -> np.ndarray:
    """Return the (C,) offsets relative to the first camera with the largest sum of gains.

    The search starts from the best pair and adds cameras. Coordinate descent over the cameras improves the result
    (Besag 1986). Among equal offsets the one nearest to zero wins.
    """

    def best(gains: np.ndarray) -> int:
        at = np.flatnonzero(gains == gains.max()) - len(gains) // 2
        return int(at[np.abs(at).argmin()])

    i, j = max(tables, key=lambda pair: tables[pair].max())
    placed = {i: 0, j: best(tables[i, j])}
    while len(placed) < count:
        profiles = {c: offset_profile(tables, c, placed) for c in range(count) if c not in placed}
        c = max(profiles, key=lambda c: profiles[c].max())
        placed[c] = best(profiles[c])
    for _ in range(MOST_ROUNDS):
        before = dict(placed)
        for c in range(count):
            placed[c] = best(offset_profile(tables, c, {o: at for o, at in placed.items() if o != c}))
        if placed == before:
            break
    offsets = np.array([placed[c] for c in range(count)])
    return offsets - offsets[0]


@dataclass(frozen=True)
class _PairGains:
    """Gains of the pairs of C views at offsets from -(F-1) to F-1, in matching frames.

    A frame's gain is the decrease of its distance at an offset relative to the median over the other view's frames. A
    view without motion has no gain.
    """

    gains: Tables
    possible: Tables  # Largest possible gains.
    step: int  # Frames between compared offsets. Those between have the gain of the nearest.

    def of_cameras(self, offsets: np.ndarray, among: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Return (C,) gains of each camera with all others or ``among``, and the largest gains."""
        found = np.zeros((2, len(offsets)))
        for (i, j), gains in self.gains.items():
            row = int(offsets[j] - offsets[i]) + len(gains) // 2
            if 0 <= row < len(gains) and (among is None or (among[i] and among[j])):
                found[:, [i, j]] += np.array([[gains[row]], [self.possible[i, j][row]]])
        return found[0], found[1]

    def strengths(self, offsets: np.ndarray) -> np.ndarray:
        """Return the (C,) matching frames of each camera, times their squared share."""
        gained, possible = self.of_cameras(offsets)
        return gained * (gained / np.maximum(possible, 1e-9)) ** 2


def _pair_gains(cameras: Cameras, xy: np.ndarray, most_samples: int = SAMPLES, scale: float = MOVED) -> _PairGains:
    """Return the gains of all pairs of views (F, P, J, 2), or of neighbours in large arrays.

    At most ``most_samples`` frames per view are compared with all frames of another view.
    """
    views, num_frames = [_ViewPeople.of(view) for view in xy], xy.shape[1]
    pairs = compared_pairs(len(views), EACH, NEIGHBOURS)
    samples = int(np.clip(most_samples * SAMPLED_PAIRS // max(len(pairs), 1), FEWEST_SAMPLES, most_samples))
    rows = [view.lively_frames(samples) for view in views]
    step = max(1, -(-samples * num_frames * views[0].extent.shape[1] ** 2 // MOST_CELLS))
    thinned = [view.rows(np.arange(0, num_frames, step)) for view in views]
    nearest = np.minimum((np.arange(num_frames) + step // 2) // step, len(thinned[0].extent) - 1)
    tables: tuple[Tables, Tables] = ({}, {})
    for i, j in pairs:
        share = _disagreements(cameras, (i, j), views[i].rows(rows[i]), thinned[j], scale)
        known = np.isfinite(share)
        usual, seen, whole = np.full(len(share), np.nan), known.any(axis=1), known.all(axis=1)
        usual[whole] = np.median(share[whole], axis=1)  # many times as fast as the other one
        usual[seen & ~whole] = np.nanmedian(share[seen & ~whole], axis=1)
        for table, gain in zip(tables, (usual[:, None] - share, usual[:, None]), strict=True):
            gain, total = np.where(known, gain, 0.0), np.zeros(2 * num_frames - 1)
            for row, frame in zip(gain, rows[i], strict=True):
                total[num_frames - 1 - frame : 2 * num_frames - 1 - frame] += row[nearest]
            table[i, j] = total
    return _PairGains(*tables, step)


class StartEvidence(Enum):
    """Evidence for the cameras' starts."""

    IN_STEP = "in step"  # They agree by their frame numbers, and no other offset is better by a margin.
    APART = "apart"  # They agree far better at other offsets, and only there.
    STILL = "still"  # Unknown, because too little moves or is visible in two cameras.
    AMBIGUOUS = "ambiguous"  # They agree equally at several offsets, and less by their frame numbers.


@dataclass(frozen=True)
class CameraStarts:
    """Row of each of C cameras that corresponds to row 0 of the take."""

    offsets: np.ndarray  # (C,) whole frames. Frame f of the take is row f + offset of the camera.
    evidence: StartEvidence  # Evidence. Unless it is ``APART``, the offsets are the numbered ones.
    doubtful: tuple[int, ...] = ()  # Cameras without evidence, or for ``AMBIGUOUS`` those with several offsets.
    rivals: tuple[int, int] = (0, 0)  # The two best offsets of the first of these relative to the first camera.


def find_starts(cameras: Cameras, detections: Detections, fps: float, numbered: np.ndarray) -> CameraStarts:
    """Estimate the start of each camera in whole frames, with alternatives if ambiguous.

    Row 0 is the first recorded frame of a camera, and ``numbered`` (C,) are the offsets from the frame numbers. The
    solve measures the remaining fractions of a frame.
    """
    seeing = np.flatnonzero(detections.people().any(axis=1))
    everybody = tuple(range(len(cameras)))
    if len(seeing) < 2:
        return CameraStarts(numbered, StartEvidence.STILL, everybody)
    names = tuple(cameras.names[c] for c in seeing)
    part = Detections(names, detections.xy[seeing], detections.confidence[seeing], detections.joint_set)
    seen = sightings(cameras.subset(seeing.tolist()), part)
    gains = _pair_gains(seen.cameras, seen.xy)
    best = best_offsets(gains.gains, len(seeing))
    sure = gains.strengths(best) >= LEAST_STRENGTH
    doubtful = tuple(seeing[~sure].tolist())
    if sure.sum() < 2:
        return CameraStarts(numbered, StartEvidence.STILL, everybody)
    now, then = (gains.of_cameras(offsets, sure)[0] for offsets in (numbered[seeing], best))
    if (now >= RIVAL_SHARE * then)[sure].all():
        return CameraStarts(numbered, StartEvidence.STILL if doubtful else StartEvidence.IN_STEP, doubtful)
    if open_ := _rivals(gains, best, np.flatnonzero(sure), max(round(NEAR_S * fps), gains.step)):
        several = tuple(int(seeing[c]) for c in open_)
        return CameraStarts(numbered, StartEvidence.AMBIGUOUS, several, next(iter(open_.values())))
    best = best[sure]
    fine = _pair_gains(seen.cameras.subset(np.flatnonzero(sure).tolist()), seen.xy[sure], SAMPLED_FRAMES, FINE).gains
    for (i, j), table in fine.items():
        changes = np.arange(len(table)) - len(table) // 2 - int(best[j] - best[i])
        table[np.abs(changes) > STRIDE + gains.step] = 0.0
    offsets = numbered.copy()
    offsets[seeing[sure]] = best[0] + best_offsets(fine, len(best))
    return CameraStarts(offsets, StartEvidence.APART, doubtful)


def _rivals(gains: _PairGains, best: np.ndarray, sure: np.ndarray, near: int) -> dict[int, tuple[int, int]]:
    """Return the two best offsets of each camera that has a distant alternative.

    Cameras are shifted singly and in pairs, because two opposite cameras may agree with the others at several offsets.
    """
    reach = 2 * (len(next(iter(gains.gains.values()))) // 2)
    changes = np.arange(-reach, reach + 1)
    found: dict[int, tuple[int, int]] = {}
    alone = [(int(c),) for c in sure]
    for group in alone + list(combinations(sure.tolist(), 2)) * (len(sure) > 3):
        others = {int(o): int(best[o]) for o in sure if o not in group}
        total = np.zeros(len(changes))
        for c in group:
            rows = changes + reach + int(best[c])
            inside = (rows >= 0) & (rows <= 2 * reach)
            total += np.where(inside, offset_profile(gains.gains, c, others)[np.clip(rows, 0, 2 * reach)], 0.0)
        rival = int(np.where(np.abs(changes) > near, total, -np.inf).argmax())
        if total[rival] > RIVAL_SHARE * total[reach]:
            shown = group[0] if group[0] else next(iter(others))
            change = int(changes[rival]) * (1 if group[0] else -1)
            found.setdefault(shown, (int(best[shown]), int(best[shown]) + change))
    return found


def strength(cameras: Cameras, detections: Detections) -> float:
    """Return the strength of the best match of a few frames, see ``_PairGains.strengths``."""
    step = max(1, -(-detections.num_frames // SAMPLED_FRAMES))
    thin = replace(detections, xy=detections.xy[:, ::step], confidence=detections.confidence[:, ::step], hands=None)
    gains = _pair_gains(cameras, sightings(cameras, thin).xy, FEWEST_SAMPLES)
    return float(np.median(gains.strengths(best_offsets(gains.gains, len(cameras)))))


def read_out_of_step(cameras: Cameras, detections: Detections) -> Reading | None:
    """Return the interpretation for which all cameras match clearly best at some offsets, or None."""
    count, written = len(cameras), Reading.as_written(len(cameras))
    if not 2 <= count <= EACH or not (detections.people() > 0).any(axis=1).all():
        return None
    readings = [replace(written, pictures=(PictureReading(*kind),) * count) for kind in product(FACTORS, TURNS)]
    readings += [replace(written, pose=pose, graphics=axes) for pose, axes in product(POSES, (False, True))]
    strengths = {reading: strength(*apply_reading(cameras, detections, reading)) for reading in dict.fromkeys(readings)}
    best = max(strengths, key=lambda reading: strengths[reading])
    rivals = [strengths[reading] for reading in strengths if _differ(reading, best)]
    clear = strengths[best] >= LEAST_READING and max(rivals) < RIVAL_SHARE * strengths[best]
    return best if clear and best != written else None


def _differ(one: Reading, other: Reading) -> bool:
    """Return whether two interpretations differ in more than neighbouring sizes."""
    kinds = [(r.pose, r.graphics, r.pictures[0].turn, r == Reading.as_written(len(r.owners))) for r in (one, other)]
    return kinds[0] != kinds[1] or abs(np.log(one.pictures[0].size / other.pictures[0].size)) > NEAR_SIZE


def common_rows(offsets: np.ndarray, lengths: np.ndarray, *, every: bool = False) -> tuple[int, int]:
    """Return the first row of the take, and one past its last row, on the first camera's clock.

    Frame f of the take is row f + offset (C,) of a camera. Cameras that recorded no rows are ignored.
    With ``every``, only rows that all cameras recorded are used, even if they are few.
    """
    recorded = lengths > 0
    first, stop = -offsets[recorded], (lengths - offsets)[recorded]
    low, high = int(first.max()), int(stop.min())
    if every or 2 * (high - low) >= lengths[recorded].min():
        return low, high
    # Few rows are common to all. By two cameras: from the second start to the second-last end.
    moments = np.arange(int(first.min()), int(stop.max()))
    several = ((moments[:, None] >= first) & (moments[:, None] < stop)).sum(1) >= min(2, len(first))
    return (int(moments[several][0]), int(moments[several][-1]) + 1) if several.any() else (0, 0)


def align_rows(detections: Detections, offsets: np.ndarray, first: int, stop: int) -> Detections:
    """Return rows ``first`` to ``stop - 1`` of the take, see ``common_rows``. Others are empty."""
    return _at_rows(detections, np.arange(first, stop) + offsets[:, None])


def _at_rows(detections: Detections, rows: np.ndarray) -> Detections:
    """Return the (C, N) rows of each camera. Rows that do not exist have no people."""
    beyond, views = (rows < 0) | (rows >= detections.num_frames), np.arange(len(rows))[:, None]
    rows = np.clip(rows, 0, max(detections.num_frames - 1, 0))
    xy, confidence = detections.xy[views, rows], detections.confidence[views, rows]
    xy[beyond], confidence[beyond] = np.nan, 0.0
    hands = None if detections.hands is None else detections.hands[views, rows]
    if hands is not None:
        hands[beyond] = UNSEEN_POINT
    return replace(detections, xy=xy, confidence=confidence, hands=hands)


def nearest_rows(detections: Detections, rates: Sequence[float]) -> Detections:
    """Return the nearest frame of each camera for every frame, at (C,) camera frames per frame."""
    moments = [np.round(_moments(detections, c, rate)).astype(int) for c, rate in enumerate(rates)]
    rows = np.full((len(moments), max(map(len, moments))), -1)
    for row, at in zip(rows, moments, strict=True):
        row[: len(at)] = np.minimum(at, detections.num_frames - 1)
    return replace(_at_rows(detections, rows), first_frames=(), lengths=())


def at_one_rate(detections: Detections, rates: Sequence[float]) -> Detections:
    """Return every camera at the take's rate, interpolated if two frames show one person."""
    count = len(detections.cameras)
    result = nearest_rows(detections, rates)
    lengths = detections.lengths or (detections.num_frames,) * count
    kept = []
    for c, rate in enumerate(rates):
        kept.append(int((lengths[c] - 1) / rate) + 1)
        if rate != 1.0:
            _interpolate(detections, result, c, _moments(detections, c, rate))
    firsts = detections.first_frames or (detections.first_frame,) * count
    firsts = tuple(round(first / rate) for first, rate in zip(firsts, rates, strict=True))
    apart = len(set(firsts)) > 1 or len(set(kept)) > 1
    return replace(result, first_frames=firsts if apart else (), lengths=tuple(kept) if apart else ())


def _moments(detections: Detections, c: int, rate: float) -> np.ndarray:
    """Return the fractional row of a camera for every frame of the take."""
    length = detections.lengths[c] if detections.lengths else detections.num_frames
    return np.arange(int((length - 1) / rate) + 1) * rate


def _interpolate(detections: Detections, result: Detections, c: int, at: np.ndarray) -> None:
    """Write interpolated keypoints between two frames with the same person into ``result``."""
    before = np.floor(at).astype(int)
    after = np.minimum(before + 1, detections.num_frames - 1)
    share = (at - before)[:, None, None, None]
    one, other = detections.xy[c, before], detections.xy[c, after]
    both = np.isfinite(one).all(-1) & np.isfinite(other).all(-1)
    seen = np.where(both[..., None], one, np.nan)
    move = np.where(both, np.linalg.norm(other - one, axis=-1), 0.0).sum(-1) / np.maximum(both.sum(-1), 1)
    same = both & (move < STEP_SHARE * np.nan_to_num(extent(seen)))[..., None]
    result.xy[c, : len(at)][same] = ((1 - share) * one + share * other)[same]
    sure = np.minimum(detections.confidence[c, before], detections.confidence[c, after])
    result.confidence[c, : len(at)][same] = sure[same]
    if result.hands is not None and detections.hands is not None:
        one, other = detections.hands[c, before], detections.hands[c, after]
        together = same.any(-1)[..., None, None] & (one[..., 2] > 0) & (other[..., 2] > 0)
        between = (1 - share[..., None]) * one + share[..., None] * other
        result.hands[c, : len(at)][together] = between[together]


SAME_FRAMES = 2.0  # Largest difference of frame numbers for cameras that record the same duration.
CAMERA_RATES = (24.0, 25.0, 30.0, 48.0, 50.0, 60.0, 90.0, 100.0, 120.0, 240.0)  # Usual frame rates.


def rates_by_length(cameras: Cameras, detections: Detections, numbered: Detections) -> np.ndarray:
    """Return (C,) frames of each camera per frame of the longest one, usually 1.

    Cameras start with their own first frames, but ``numbered`` detections are aligned by frame numbers.
    """
    as_they_are, longest = np.ones(len(cameras)), max(detections.lengths, default=0)
    ratios = np.array([_standard(length, longest) for length in detections.lengths])
    if (ratios == 1.0).all():
        return as_they_are
    resampled, written = nearest_rows(detections, ratios.tolist()), Reading.as_written(len(cameras))
    then, now = (TakeEvidence(cameras, rows).nats([written])[0] for rows in (resampled, numbered))
    return ratios if then >= BOUND and then >= now + BOUND else as_they_are


def rates_match(cameras: Cameras, detections: Detections, rates: np.ndarray) -> bool:
    """Return whether views match better if their (C,) frame rates differ relative to the take's."""
    tried = (nearest_rows(detections, r.tolist()) for r in (rates, np.ones(len(rates))))
    then, now = (strength(cameras, rows) for rows in tried)
    return now < RIVAL_SHARE * then


def _standard(length: int, longest: int) -> float:
    """Return the ratio of two usual frame rates that explains two frame counts, otherwise 1."""
    ratios = sorted({round(a / b, 6) for a, b in product(CAMERA_RATES, CAMERA_RATES) if 0.2 < a / b < 5})
    ratio = min(ratios, key=lambda ratio: abs(ratio * longest - length))
    return ratio if abs(ratio * longest - length) <= SAME_FRAMES else 1.0
