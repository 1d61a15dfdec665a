"""A detector of hands with the errors of a real one, as shares of the palm in the picture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.cameras.projection import project
from solver_backend.exchange.hand_points import NUM_HAND_POINTS
from solver_backend.synthesis.embedded.temporal_noise import autoregressive, bursts
from solver_backend.types import UNSEEN_POINT, Cameras

_WRIST, _KNUCKLE = 0, 9
BEYOND = np.array([k > 0 and (k - 1) % 4 > 0 for k in range(NUM_HAND_POINTS)])
"""(21,) points beyond the knuckles."""


@dataclass(frozen=True)
class HandFaults:
    """How much a detector of hands is off; lengths are shares of a palm, wrist to middle knuckle.

    ``whole``, ``drift`` and ``jitter`` are those of MediaPipe's model on palms of 35 to 60 px (Pose2Sim's balancing
    videos), as ``python -m tests.benchmarks.hands.real_noise`` measures them: 0.05, 0.10 and 0.036 with cameras
    that were refined, as the studio's cameras are off by themselves; 0.03, 0.04 and 0.016 on palms of 60 to 140 px.
    """

    whole: float = 0.05
    """Standard deviation per axis of an error of the whole hand, alike for ``drift_s``."""
    drift: float = 0.10
    """The same of each point."""
    jitter: float = 0.036
    """Of each point, anew in every frame."""
    drift_s: float = 0.3
    """Time in which drift becomes another."""
    guessed: float = 2.5
    """How many times worse points are that something hides."""
    least_seen: float = 0.5
    """Share of the points that must be seen for a hand to be found."""
    missing: float = 0.06
    """Share of the frames in which a hand is not found though it is seen ..."""
    missing_s: float = 0.15
    """... for so long."""
    wrong: float = 0.01
    """Share in which it is found elsewhere, a palm or two away."""
    exchanged: float = 0.005
    """Share of the frames in which left and right are exchanged."""
    held: bool = False
    """Whether hands hold a thing that hides fingers beyond the knuckles: these are guesses, found half as often."""
    gloved: bool = False
    """Whether they wear gloves: every point is a guess, found half as often."""
    small_px: float = 15.0
    """Palms of fewer pixels: errors grow with the square of what is missing."""


def detect_hands(
    cameras: Cameras, points: np.ndarray, hidden: np.ndarray, fps: float, faults: HandFaults, rng: np.random.Generator
) -> np.ndarray:
    """Return (C, F, 2, 21, 3) x, y in pixels and confidence; NaN with 0 where a hand is not found.

    Args:
        cameras: C cameras.
        points: (F, 2, 21, 3) metres, left first.
        hidden: (C, F, 2, 21) whether something stands before a point.
        fps: frames per second.
        faults: of the detector.
        rng: seeded source of randomness.
    """
    hidden = hidden | faults.gloved
    if faults.held:
        hidden = hidden | BEYOND
    px = project(cameras, points)
    palm = np.linalg.norm(px[..., _KNUCKLE, :] - px[..., _WRIST, :], axis=-1)
    # Seen end on a palm is short; the detector looks at the hand, not at the palm.
    size = np.fmax(palm, np.nanmax(np.linalg.norm(px - px[..., :1, :], axis=-1), axis=-1) / 2)
    unit = (size * np.maximum(1.0, (faults.small_px / np.maximum(size, 1.0)) ** 2))[..., None, None]
    keep = float(np.exp(-1.0 / (faults.drift_s * fps)))
    whole = faults.whole * autoregressive((*px.shape[:3], 1, 2), keep, rng)
    own = faults.drift * autoregressive(px.shape, keep, rng) + faults.jitter * rng.normal(size=px.shape)
    error = whole + own * np.where(hidden, faults.guessed, 1.0)[..., None]
    shape = px.shape[:3]
    wrong = bursts(rng.random(shape), faults.wrong, max(1.0, 0.2 * fps))
    away = rng.normal(size=(*shape, 1, 2))
    error = error + np.where(wrong[..., None, None], 1.5 * away / np.linalg.norm(away, axis=-1, keepdims=True), 0.0)
    xy = px + unit * error
    inside = ((xy >= 0) & (xy < cameras.image_size[:, None, None, None])).all(-1)
    lost = bursts(rng.random(shape), faults.missing, max(1.0, faults.missing_s * fps))
    enough = (~hidden & inside).mean(-1) >= faults.least_seen
    # What hides the fingers of every view hides them from a detector that knows such hands; it misses every other one.
    if faults.held or faults.gloved:
        enough = bursts(rng.random(shape), 0.5, max(1.0, faults.missing_s * fps)) & inside.all(-1)
    found = ~lost & enough
    confidence = np.clip(0.9 - 0.25 * hidden + 0.08 * rng.normal(size=hidden.shape), 0.05, 1.0)
    hands = np.concatenate([xy, confidence[..., None]], axis=-1)
    hands[~(found[..., None] & inside)] = UNSEEN_POINT
    exchanged = bursts(rng.random(shape[:2]), faults.exchanged, max(1.0, 0.2 * fps))
    return np.where(exchanged[..., None, None, None], hands[:, :, ::-1], hands)
