"""Which parts of the body the located landmarks inform, frame by frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.kinematics import subtree_matrix
from solver_backend.body.landmark_set import Landmarks
from solver_backend.fitters.measurements.base import Measurements
from solver_backend.fitters.partial_body.resting_spread import ANCHORS

LEADS: dict[str, tuple[str, float]] = {
    "trunk": ("spine1", 0.08), "head": ("neck", 0.06), "left_upper_arm": ("left_shoulder", 0.06),
    "right_upper_arm": ("right_shoulder", 0.06), "left_forearm": ("left_elbow", 0.06),
    "right_forearm": ("right_elbow", 0.06), "left_thigh": ("left_hip", 0.06), "right_thigh": ("right_hip", 0.06),
    "left_shank": ("left_knee", 0.06), "right_shank": ("right_knee", 0.06),
}  # fmt: skip
"""The joint whose turn poses each part of ``PARTS``, and the least lever in metres of a landmark that informs it. The
waist's markers have levers of 53 mm about the lowest joint of the spine and T12 131; C7 has 31 about the neck, the
acromion 34 about the shoulder, the elbow's 31 about the elbow, and the tibia's tuberosity 74 about the knee."""
HOLD_S, FADE_S = 0.5, 0.5
"""So long after it was last informed (and before it is again) a part follows the fit; then it comes to rest in the
time that follows. Gaps of up to a second are bridged as ever."""
UNKNOWN_S = 0.5
"""So long before the first and after the last frame that informs a part, its deviation rises to that of one at rest:
nothing leads back from there, and the fit states 14 to 26 mm of arms that are 29 to 242 mm off in the last 0.25 and
0.5 s without markers (CMU 02_01 and 135_02, five exercises of UI-PRMD). Its pose follows the fit, which is nearer than
a rest: 38 to 90 mm against 197 to 293 in 0.5 s of three exercises."""


BETWEEN = 0.4
"""Share of the resting variance that a part has at most while it is bridged between frames that inform it. In gaps of
0.5 and 1 s of arms and legs (CMU 02_01, 135_02) joints are 40 to 175 mm off per axis where the fit states 8 to 22; in
one of 0.1 s the third power leaves 3 % of the deviation at rest."""


@dataclass(frozen=True)
class PartShares:
    """What is at rest, and what is as little known as if it were: (F,) from 0 to 1 of each part that is anywhere."""

    rest: dict[str, np.ndarray]
    """How far a part is at rest."""
    spread: dict[str, np.ndarray]
    """Share of the resting variance that its own has: at least as much."""


def resting_shares(
    body: Body, landmarks: Landmarks, offsets: np.ndarray, located: np.ndarray, seen: np.ndarray, fps: float,
    pinned: Sequence[int] = (),
) -> PartShares:  # fmt: skip
    """Return how far each part that is not informed throughout is at rest, and how little is known of it.

    A landmark informs a part where it moves by ``LEADS``' lever when the part's first joint turns. The rest rises as
    ``3 u² - 2 u³`` while u, the time since ``HOLD_S`` after the part was informed over ``FADE_S``, rises from 0 to 1;
    before the first and after the last informed frame the variance rises with the time over ``UNKNOWN_S``, squared, and
    between informed frames with its third power up to ``BETWEEN``.

    Args:
        body: whose tree and rest skeleton.
        landmarks: L landmarks.
        offsets: (L, 3) of the landmarks in the rest frame, metres.
        located: (F, L) bool.
        seen: (F,) bool: enough is located to place the body. Between such frames shares lie on straight lines.
        fps: frames per second.
        pinned: frames whose poses somebody set, which informs every part.
    """
    known = np.isin(np.arange(len(seen)), list(pinned))
    frames, every, found = np.flatnonzero(seen | known), np.arange(len(seen)), PartShares({}, {})
    if not len(frames):
        return found
    lever = levers(body, landmarks, offsets)
    for part, (joint, least) in LEADS.items():
        if not {joint, ANCHORS[part]} <= set(body.layout.joints):
            continue
        informed = (
            located[np.ix_(frames, lever[:, body.layout.joints.index(joint)] >= least)].any(axis=1) | known[frames]
        )
        away, between = _distance(frames, frames[informed])
        u, gone = np.clip((away / fps - HOLD_S) / FADE_S, 0.0, 1.0), np.minimum(away / fps / UNKNOWN_S, 1.0)
        rest, unknown = u * u * (3.0 - 2.0 * u), np.where(between, np.minimum(gone**3, BETWEEN), gone**2)
        if rest.any():
            found.rest[part] = np.interp(every, frames, rest)
        if rest.any() or unknown.any():
            found.spread[part] = np.interp(every, frames, np.maximum(rest, unknown))
    return found


def uninformed_parts(body: Body, measurements: Measurements) -> tuple[str, ...]:
    """Return the parts that are informed in no frame, by landmarks without offsets."""
    return parts_without(body, measurements.landmarks, measurements.located.any(axis=0))


def parts_without(body: Body, landmarks: Landmarks, located: np.ndarray) -> tuple[str, ...]:
    """Return the parts that no landmark of those located, (L,) bool, informs, all of them without offsets."""
    once, offsets = np.ones(1, dtype=bool), np.zeros((len(landmarks), 3))
    return tuple(resting_shares(body, landmarks, offsets, located[None], once, 1.0).rest)


def levers(body: Body, landmarks: Landmarks, offsets: np.ndarray) -> np.ndarray:
    """Return (L, J) how far landmarks at rest move by the turn of each joint, metres per radian about a far axis."""
    below = subtree_matrix(body.parents)
    share = landmarks.weights @ below.T
    places = np.einsum("jb,lbi->lji", below, landmarks.anchors) + share[..., None] * offsets[:, None]
    return np.linalg.norm(places - share[..., None] * body.joints_template, axis=-1)


def _distance(frames: np.ndarray, informed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return how many frames each is from the nearest informed one, infinite without any, and if it is between two."""
    if not len(informed):
        return np.full(len(frames), np.inf), np.zeros(len(frames), dtype=bool)
    after = np.searchsorted(informed, frames)
    left, right = informed[np.maximum(after - 1, 0)], informed[np.minimum(after, len(informed) - 1)]
    away = np.minimum(np.abs(frames - left), np.abs(frames - right)).astype(np.float64)
    return away, (frames >= informed[0]) & (frames <= informed[-1])
