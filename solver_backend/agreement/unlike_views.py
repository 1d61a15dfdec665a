"""Cameras that agree with the others at no offset as they are: of another frame rate, or calibrated otherwise.

Views whose best offset matches most of what could match belong together. A group that is left over is tried in every
frame rate that cameras have and in every reading of its calibration, at all offsets and on few frames; the one under
which it matches is right, if no other comes near.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product

import numpy as np

from solver_backend.agreement.camera_starts import largest_gain
from solver_backend.agreement.detections import Detections, sightings
from solver_backend.agreement.offset_gains import PairGains, PairTable, pair_gains
from solver_backend.agreement.resampled import nearest_rows, standard_ratios
from solver_backend.cameras.camera_corrections import FACTORS, POSES, TURNS, CameraCorrection, corrected
from solver_backend.types import Cameras

MATCHING, MATCHING_SHARE, APART_SHARE = 0.25, 0.7, 0.9
"""Share of what could match from which two views belong together, and the same of the best pair's share, more where
cameras recorded different numbers of frames: simulated views reach 0.8 to 0.95, those of the demo, where little moves,
0.33 to 0.66; views of other rates 0.2 to 0.4."""
RIVAL_SHARE = 0.6
"""Another reading that gains so much leaves open which is right."""
LEAST_READING = 1.0
"""Frames that match for each camera, counted as ``LEAST_STRENGTH``, of which there are four times as many samples."""
LEAST_GAIN = 1.0
"""Frames that match at least: a short overlap may agree by chance."""
OTHER_RATE, OTHER_SIZE = 0.15, 0.5
"""Logarithms of rates, and of sizes of pictures, up to which readings are neighbours, which gain alike."""
STILL = 0.1, 0.7
"""Share of what could match, and how far most frames disagree, below which both nothing moves: nothing shows when such
views were recorded. Of pictures of another size or turn all frames disagree."""
_ROWS, _SAMPLES = 300, 40
"""Frames of each view that are looked at, and those of one that are compared with all of another."""
_MOST_CAMERAS = 8
"""Larger arrays are not searched: what is wrong with one of many is seen by the others."""


@dataclass(frozen=True)
class ViewReading:
    """How a camera is read."""

    correction: CameraCorrection = field(default_factory=CameraCorrection)
    """Of its calibration."""
    rate: float = 1.0
    """Its frames for each of the other cameras'."""


def explain_unlike(cameras: Cameras, detections: Detections) -> tuple[ViewReading, ...] | None:
    """Return how C cameras are read so that all of them match, None where they do as they are or nothing explains it.

    Args:
        cameras: C cameras as written.
        detections: everybody; each camera from its own first frame.
    """
    plain = [ViewReading()] * len(cameras)
    seeing = np.flatnonzero(detections.people().any(axis=1)).tolist()
    if not 2 <= len(seeing) <= _MOST_CAMERAS:
        return None
    tried = _Tried(cameras, detections, seeing)
    groups = tried.groups(plain)
    if len(groups) == 1:
        return None
    base = groups[0]
    if len(base) == 1:
        alike = [[reading] * len(cameras) for reading in _corrections()]
        if (found := _clearly_best(alike, tried.strength_of_all)) is not None:
            return tuple(found) if len(tried.groups(found, 0.0)) == 1 else None
    readings = list(plain)
    for group in groups[1:]:
        for ways in (_rates(), _pictures()):
            options = [_with(readings, group, way) for way in ways]
            found = _clearly_best(options, partial(tried.strength, base=base, group=group))
            if found is not None:
                readings, base = found, [*base, *group]
                break
        else:
            return None
    return tuple(readings)


def views_match(cameras: Cameras, detections: Detections) -> bool:
    """Return whether every view matches another at some offset, and all of them hang together so.

    Args: those of ``explain_unlike``. Larger arrays are taken to match.
    """
    seeing = np.flatnonzero(detections.people().any(axis=1)).tolist()
    if not 2 <= len(seeing) <= _MOST_CAMERAS:
        return True
    return len(_Tried(cameras, detections, seeing).groups([ViewReading()] * len(cameras))) == 1


def _with(readings: Sequence[ViewReading], group: Sequence[int], way: ViewReading) -> list[ViewReading]:
    return [way if c in group else reading for c, reading in enumerate(readings)]


def _rates() -> list[ViewReading]:
    return [ViewReading(rate=ratio) for ratio in standard_ratios()]


def _pictures() -> list[ViewReading]:
    return [ViewReading(CameraCorrection(factor=factor, turn=turn)) for factor, turn in product(FACTORS, TURNS)]


def _corrections() -> list[ViewReading]:
    """Return all readings; how poses are written is the same for all cameras of a file."""
    poses = [CameraCorrection(pose=pose, graphics=graphics) for pose, graphics in product(POSES, (False, True))]
    return list(dict.fromkeys([*_pictures(), *map(ViewReading, poses)]))


def _clearly_best(
    options: Sequence[list[ViewReading]], strength: Callable[[list[ViewReading]], float]
) -> list[ViewReading] | None:
    """Return the option that is strongest, None if it is weak or a rival is nearly as strong.

    Rivals are options of a different kind, and cameras as they are: 24 frames a second for 25 hardly differ in a short
    take, where a lens that is calibrated otherwise gains by the one as by the other.
    """
    found = np.array([strength(option) for option in options])
    best = options[int(found.argmax())]
    plain = ViewReading()
    rivals = [
        s for option, s in zip(options, found, strict=True)
        if _differ(option, best) or any(b != plain and o == plain for b, o in zip(best, option, strict=True))
    ]  # fmt: skip
    return best if found.max() >= LEAST_READING and max(rivals) < RIVAL_SHARE * found.max() else None


def _differ(one: Sequence[ViewReading], other: Sequence[ViewReading]) -> bool:
    """Whether readings differ in more than what neighbours of a scale differ in."""

    def kind(r: ViewReading) -> tuple[object, ...]:
        return r.correction.turn, r.correction.pose, r.correction.graphics

    def apart(a: ViewReading, b: ViewReading) -> bool:
        rates, factors = a.rate / b.rate, a.correction.factor / b.correction.factor
        return kind(a) != kind(b) or abs(np.log(rates)) > OTHER_RATE or abs(np.log(factors)) > OTHER_SIZE

    return any(apart(a, b) for a, b in zip(one, other, strict=True))


class _Tried:
    """Gains of views under different readings, on few frames; what two readings share is computed once."""

    def __init__(self, cameras: Cameras, detections: Detections, seeing: list[int]) -> None:
        self._cameras, self._seeing = cameras, seeing
        self._share = APART_SHARE if len(set(detections.lengths)) > 1 else MATCHING_SHARE
        step = max(1, -(-detections.num_frames // _ROWS))
        self._thin = replace(
            detections, xy=detections.xy[:, ::step], confidence=detections.confidence[:, ::step], hands=None
        )
        self._points: dict[tuple[int, float, int, float], np.ndarray] = {}
        self._pairs: dict[Hashable, PairTable] = {}

    def groups(self, readings: Sequence[ViewReading], share: float | None = None) -> list[list[int]]:
        """Return the cameras that match with each other, or show too little to know, the largest group first.

        Args:
            readings: one a camera.
            share: of the best pair's match that others must reach; by the numbers of frames where left out.
        """
        gains = self._gains(readings, self._seeing)
        matched = {pair: _matched(table, gains.possible[pair]) for pair, table in gains.tables.items()}
        least = max(MATCHING, (self._share if share is None else share) * max(matched.values()))
        group_of = {c: {c} for c in self._seeing}
        for (i, j), share in matched.items():
            still = share < STILL[0] and gains.usual[i, j] < STILL[1]
            if still or share >= least:
                a, b = self._seeing[i], self._seeing[j]
                joined = group_of[a] | group_of[b]
                group_of |= dict.fromkeys(joined, joined)
        distinct = {tuple(sorted(group)) for group in group_of.values()}
        return [list(group) for group in sorted(distinct, key=lambda group: (-len(group), group))]

    def strength(self, readings: Sequence[ViewReading], base: Sequence[int], group: Sequence[int]) -> float:
        """Return how many frames match between the first camera of a group and the base."""
        chosen = [*base, group[0]]
        return self._strength(self._gains(readings, chosen), len(chosen), of_last=True)

    def strength_of_all(self, readings: Sequence[ViewReading]) -> float:
        """Return how many frames match for each of the cameras."""
        return self._strength(self._gains(readings, self._seeing), len(self._seeing))

    def _strength(self, gains: PairGains, count: int, of_last: bool = False) -> float:
        gained, possible = gains.of_cameras(largest_gain(gains, count))
        strengths = [_strength(float(g), float(p)) for g, p in zip(gained, possible, strict=True)]
        return strengths[-1] if of_last else float(np.median(strengths))

    def _gains(self, readings: Sequence[ViewReading], chosen: Sequence[int]) -> PairGains:
        cameras = corrected(self._cameras.subset(list(chosen)), [readings[c].correction for c in chosen])
        seen = [self._seen(cameras.subset([k]), c, readings[c]) for k, c in enumerate(chosen)]
        xy = np.full((len(chosen), max(map(len, seen)), *seen[0].shape[1:]), np.nan)
        for k, points in enumerate(seen):
            xy[k, : len(points)] = points
        return pair_gains(cameras, xy, _SAMPLES, [(c, readings[c]) for c in chosen], self._pairs)

    def _seen(self, camera: Cameras, c: int, reading: ViewReading) -> np.ndarray:
        """Return (F, P, J, 2) normalised points of a camera so read; how it stands does not move them."""
        key = (c, reading.correction.factor, reading.correction.turn, reading.rate)
        if key not in self._points:
            self._points[key] = sightings(camera, nearest_rows(self._thin, [c], [reading.rate])).xy[0]
        return self._points[key]


def _strength(gained: float, possible: float) -> float:
    """Return the frames that match, counted by the square of the share of what could."""
    return gained * (gained / max(possible, 1e-9)) ** 2


def _matched(table: np.ndarray, possible: np.ndarray) -> float:
    """Return the share of what could match that does, at the offset where most does; 0 where hardly anything does."""
    row = int(table.argmax())
    return float(table[row]) / float(possible[row]) if table[row] >= LEAST_GAIN else 0.0
