"""How many frames apart cameras started, by which frames of their views agree: a finding only with a margin."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum
from itertools import combinations

import numpy as np

from solver_backend.agreement.detections import Detections, sightings
from solver_backend.agreement.offset_gains import (
    EACH,
    NEIGHBOURS,
    PairGains,
    ViewPeople,
    lively_frames,
    moment_disagreements,
    pair_gains,
    people_of_views,
)
from solver_backend.cameras.camera_corrections import compared_pairs
from solver_backend.types import UNSEEN_POINT, Cameras

OFF_LINE = 0.015
"""Scale of the penalty in the person's extent: 2 cm, about a detector's error."""
REACH = 4
"""Frames on either side that are tried."""
_SAMPLES, _FINER_ROUNDS = 400, 8


def refine_starts(cameras: Cameras, xy: np.ndarray, offsets: np.ndarray, reach: int = REACH) -> np.ndarray:
    """Return offsets at which the views agree best among those nearby.

    Descends along one camera after the other; the first stays.

    Args:
        cameras: C cameras.
        xy: (C, F, P, J, 2) normalised points, NaN where missing.
        offsets: (C,) frames, see ``find_starts``.
        reach: frames on either side that are tried.
    """
    views = people_of_views(xy)
    rows = [lively_frames(view, _SAMPLES) for view in views]
    changes = np.arange(-2 * reach, 2 * reach + 1)
    tables = {
        (i, j): _costs(cameras, (i, j), (views[i], views[j]), rows[i], int(offsets[j] - offsets[i]) + changes)
        for i, j in compared_pairs(len(views), EACH, NEIGHBOURS)
    }
    moved = np.zeros(len(views), int)
    tried = np.arange(-reach, reach + 1)
    for _ in range(_FINER_ROUNDS):
        before = moved.copy()
        for c in range(1, len(views)):
            total = np.zeros(len(tried))
            for (i, j), table in tables.items():
                if c in (i, j):
                    between = tried - moved[i] if c == j else moved[j] - tried
                    total += table[np.clip(between + 2 * reach, 0, 4 * reach)]
            moved[c] = tried[total.argmin()]
        if (moved == before).all():
            break
    return offsets + moved


def _costs(
    cameras: Cameras, pair: tuple[int, int], views: tuple[ViewPeople, ViewPeople], rows: np.ndarray, offsets: np.ndarray
) -> np.ndarray:
    """Return (L,) disagreements of a pair summed over the moments that all (L,) offsets leave in common."""
    at = rows[:, None] + offsets
    rows = rows[((at >= 0) & (at < len(views[1].extent))).all(axis=1)]
    if not len(rows):
        return np.zeros(len(offsets))
    first = views[0].rows(rows)
    shares = np.stack([
        moment_disagreements(cameras, *pair, first, views[1].rows(rows + offset), OFF_LINE) for offset in offsets
    ])  # fmt: skip
    known = np.isfinite(shares).all(axis=0)
    return shares[:, known].sum(axis=1)


LEAST_STRENGTH = 3.0
"""Frames that must match for each camera, counted by the square of the share of what could match: simulated cameras in
step reach 10 to 60, real ones whose calibration is off 5 to 20, cameras that have nothing in common up to 1.9."""
RIVAL_SHARE = 0.7
"""Another offset that gains so much leaves open which is right: periodic movement."""
NEAR_S = 0.35
"""Offsets so near to the best are the same finding; a period of walking is longer."""
KEPT_SHARE = 0.8
"""Cameras are left as numbered where that gains so much of the best."""
_ROUNDS = 6
"""Rounds of alignment at most; chosen by hand."""


class StartEvidence(Enum):
    """What is known of when cameras started."""

    IN_STEP = "in step"
    """They agree as they are numbered, or better nowhere with a margin."""
    APART = "apart"
    """They agree far better at other offsets, and only there."""
    STILL = "still"
    """Unknown: too little moves, or too little is seen by two cameras."""
    AMBIGUOUS = "ambiguous"
    """They agree alike at several offsets, and less as numbered."""


@dataclass(frozen=True)
class CameraStarts:
    """At which of its rows each of C cameras shows the moment of the take's row 0."""

    offsets: np.ndarray
    """(C,) whole frames; frame f of the take is row f + offset of the camera."""
    evidence: StartEvidence
    """What they rest on; with any but ``APART`` the offsets are those as numbered."""
    doubtful: tuple[int, ...] = ()
    """Cameras that show nothing; of ``AMBIGUOUS`` those that agree at several offsets."""
    rivals: tuple[int, int] = (0, 0)
    """Of the first of these, the two offsets against the first camera that gain most."""


def find_starts(cameras: Cameras, detections: Detections, fps: float, numbered: np.ndarray) -> CameraStarts:
    """Return how many frames apart cameras started.

    The offsets of all cameras are those of the largest gain summed over the pairs of views: grown from the pair that
    agrees best, then by descent along one camera after the other. No camera, and no two, may gain nearly as much at
    offsets elsewhere.

    Args:
        cameras: C calibrated cameras.
        detections: everybody; row 0 of a camera is the first frame that it recorded.
        fps: frames a second.
        numbered: (C,) offsets by the numbers of the frames.

    Reference: Besag 1986 (descent along one variable after the other).
    """
    seeing = np.flatnonzero(detections.people().any(axis=1))
    if len(seeing) < 2:
        return CameraStarts(numbered, StartEvidence.STILL, tuple(range(len(cameras))))
    part = Detections(
        tuple(cameras.names[c] for c in seeing), detections.xy[seeing], detections.confidence[seeing],
        detections.joint_set,
    )  # fmt: skip
    seen = sightings(cameras.subset(seeing.tolist()), part)
    gains = pair_gains(seen.cameras, seen.xy)
    near = max(round(NEAR_S * fps), gains.step)
    found = _judge(gains, numbered[seeing], near)
    offsets = numbered.copy()
    offsets[seeing] = found.offsets
    if found.evidence is StartEvidence.APART:
        sure = np.setdiff1d(np.arange(len(seeing)), found.doubtful)
        kept = seen.cameras.subset(sure.tolist())
        finer = refine_starts(kept, seen.xy[sure], found.offsets[sure], REACH + gains.step)
        offsets[seeing[sure]] = finer
    doubtful = tuple(int(seeing[c]) for c in found.doubtful)
    return CameraStarts(offsets, found.evidence, doubtful, found.rivals)


def _judge(gains: PairGains, numbered: np.ndarray, near: int) -> CameraStarts:
    best = largest_gain(gains, len(numbered))
    then, possible = gains.of_cameras(best)
    sure = then * (then / np.maximum(possible, 1e-9)) ** 2 >= LEAST_STRENGTH
    doubtful = tuple(np.flatnonzero(~sure).tolist())
    if sure.sum() < 2:
        return CameraStarts(numbered, StartEvidence.STILL, tuple(range(len(numbered))))
    (now, _), (then, _) = gains.of_cameras(numbered, sure), gains.of_cameras(best, sure)
    if (now >= KEPT_SHARE * then)[sure].all():
        return CameraStarts(numbered, StartEvidence.STILL if doubtful else StartEvidence.IN_STEP, doubtful)
    open_ = _rivals(gains, best, np.flatnonzero(sure), near)
    if open_:
        return CameraStarts(numbered, StartEvidence.AMBIGUOUS, tuple(open_), next(iter(open_.values())))
    return CameraStarts(np.where(sure, best, numbered), StartEvidence.APART, doubtful)


def largest_gain(gains: PairGains, count: int) -> np.ndarray:
    """Return (C,) offsets against the first camera of the largest gain."""
    i, j = max(gains.tables, key=lambda pair: gains.tables[pair].max())
    placed = {i: 0, j: int(gains.tables[i, j].argmax()) - (gains.num_frames - 1)}
    reach = 2 * (gains.num_frames - 1)
    while len(placed) < count:
        profiles = {c: gains.profile(c, placed) for c in range(count) if c not in placed}
        c = max(profiles, key=lambda c: profiles[c].max())
        placed[c] = int(profiles[c].argmax()) - reach
    for _ in range(_ROUNDS):
        before = dict(placed)
        for c in range(count):
            others = {o: at for o, at in placed.items() if o != c}
            placed[c] = int(gains.profile(c, others).argmax()) - reach
        if placed == before:
            break
    offsets = np.array([placed[c] for c in range(count)])
    return offsets - offsets[0]


def _rivals(gains: PairGains, best: np.ndarray, sure: np.ndarray, near: int) -> dict[int, tuple[int, int]]:
    """Return the two offsets that gain most, against the first camera, of each camera that has a rival elsewhere.

    Cameras move alone and by twos: two that see each other's side may agree with the other two at several offsets.
    """
    reach = 2 * (gains.num_frames - 1)
    changes = np.arange(-reach, reach + 1)
    found: dict[int, tuple[int, int]] = {}
    alone = [(int(c),) for c in sure]
    for group in alone + list(combinations(sure.tolist(), 2)) * (len(sure) > 3):
        others = {int(o): int(best[o]) for o in sure if o not in group}
        total = np.sum([_shifted(gains.profile(c, others), int(best[c])) for c in group], axis=0)
        rival = int(np.where(np.abs(changes) > near, total, -np.inf).argmax())
        if total[rival] > RIVAL_SHARE * total[reach]:
            shown = group[0] if group[0] else next(iter(others))
            change = int(changes[rival]) * (1 if group[0] else -1)
            found.setdefault(shown, (int(best[shown]), int(best[shown]) + change))
    return found


def _shifted(profile: np.ndarray, offset: int) -> np.ndarray:
    """Return a profile as a function of the change of an offset, 0 beyond its ends."""
    rows = np.arange(len(profile)) + offset
    inside = (rows >= 0) & (rows < len(profile))
    return np.where(inside, profile[np.clip(rows, 0, len(profile) - 1)], 0.0)


COMMON_SHARE = 0.5
"""The take is what all cameras recorded; where that is a smaller share of the shortest, what two of them did."""


def common_rows(offsets: np.ndarray, lengths: np.ndarray, *, every: bool = False) -> tuple[int, int]:
    """Return the first row of the take, and one past its last, on the first camera's clock.

    Args:
        offsets: (C,) frame f of the take is row f + offset of a camera.
        lengths: (C,) rows that cameras recorded; of a camera without any nothing is asked.
        every: what all cameras recorded, however short.
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
    """Return rows ``first`` to ``stop - 1`` of the take; nobody is seen where a camera did not record.

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
