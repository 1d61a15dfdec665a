"""How many frames apart cameras started, by which frames of their views agree: a finding only with a margin."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from itertools import combinations

import numpy as np

from solver_backend.people.detections import Detections
from solver_backend.people.finer_starts import REACH, refine_starts
from solver_backend.people.pair_gains import PairGains, pair_gains
from solver_backend.people.sightings import sightings
from solver_backend.types import Cameras

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
