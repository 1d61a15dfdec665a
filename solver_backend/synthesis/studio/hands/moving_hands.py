"""Hands of a person who moves: fingers within what people do, their points, and who sees them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.body.hand_angles import NUM_ANGLES
from solver_backend.body.hand_skeleton import HandSkeleton, finger_overlap
from solver_backend.body.hands import by_joint, hand_of_shape, with_fingers
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.exchange.hand_points import SIDES
from solver_backend.priors.hand_prior import HandPrior, load_hand_prior
from solver_backend.synthesis.simulation.cast import Person

SPREAD = 0.7
"""Share of the prior's deviations that fingers move by: the prior is as wide as its widest source."""
SLOWEST_HZ, FASTEST_HZ = 0.1, 0.7
"""Frequencies of the movement; gestures take half a second to open or close a hand."""
SHARES = tuple(np.linspace(1.0, 0.0, 11)[:-1].tolist())
"""Shares of a pose, between a relaxed hand and itself, that are tried until fingers do not run through one another."""
TOUCH_M = 0.002
"""Overlap of fingers that touch."""
EASE_S = 0.2
"""Half the time in which a hand relaxes before such a pose, and returns after it."""
_WAVES = 4
"""Waves that each angle is the sum of; chosen by hand."""


@dataclass(frozen=True)
class MovingHands:
    """Both hands of a person over F frames, left first."""

    skeletons: tuple[HandSkeleton, HandSkeleton]
    """Their bones."""
    angles: np.ndarray
    """(F, 2, A) radians."""
    points: np.ndarray
    """(F, 2, 21, 3) metres of ``HAND_POINTS``."""

    def rotations(self) -> np.ndarray:
        """Return (F, 30, 3, 3) rotations of the finger joints, in SMPL-H's order."""
        both = [by_joint(s.local_rotations(self.angles[:, side])) for side, s in enumerate(self.skeletons)]
        return np.concatenate(both, axis=1)


def move_hands(person: Person, fps: float, rng: np.random.Generator) -> MovingHands:
    """Return hands that move as the prior of hands has it, each for itself, at the wrists of a person.

    Args:
        person: F frames of a body that ships, or of a file with fingers.
        fps: frames per second.
        rng: seeded source of randomness.

    Raises:
        BodyInvalid: the body has no finger joints.
    """
    body, frames = with_fingers(person.body), len(person.transl)
    prior = load_hand_prior()
    skeletons = hand_of_shape(body, person.betas, 0), hand_of_shape(body, person.betas, 1)
    drawn = [_draw(prior, frames, fps, rng) for _ in SIDES]
    angles = np.stack([_apart(s, a, prior.mean, fps) for s, a in zip(skeletons, drawn, strict=True)], axis=1)
    return MovingHands(skeletons, angles, points_of_hands(person, skeletons, angles))


def points_of_hands(person: Person, skeletons: tuple[HandSkeleton, HandSkeleton], angles: np.ndarray) -> np.ndarray:
    """Return (F, 2, 21, 3) metres: the points of hands of these angles (F, 2, A) at the person's wrists."""
    posed = forward_kinematics(person.body, person.betas, person.orient, person.local, person.transl)
    found = []
    for side, skeleton in enumerate(skeletons):
        wrist = person.body.layout.joints.index(f"{SIDES[side]}_wrist")
        own = skeleton.sites(skeleton.pose(angles[:, side]), skeleton.keypoints())
        found.append(posed.joints[:, None, wrist] + (posed.G[:, None, wrist] @ own[..., None])[..., 0])
    return np.stack(found, axis=1)


def _draw(prior: HandPrior, frames: int, fps: float, rng: np.random.Generator) -> np.ndarray:
    """Return (F, A) angles: sums of slow waves with the prior's covariance, within its ranges."""
    rate = rng.uniform(SLOWEST_HZ, FASTEST_HZ, (1, NUM_ANGLES, _WAVES))
    phase = rng.uniform(0.0, 1.0, rate.shape)
    waves = np.sin(2 * np.pi * (np.arange(frames)[:, None, None] / fps * rate + phase)).sum(-1) / np.sqrt(_WAVES / 2)
    drawn = prior.mean + SPREAD * waves @ np.linalg.cholesky(prior.covariance).T
    return np.clip(drawn, prior.low, prior.high)


def _apart(skeleton: HandSkeleton, angles: np.ndarray, relaxed: np.ndarray, fps: float) -> np.ndarray:
    """Return (F, A) angles that are nearer to a relaxed hand about frames in which fingers run through one another."""
    need = np.ones(len(angles))
    for share in SHARES:
        mixed = relaxed + share * (angles - relaxed)
        deep = finger_overlap(skeleton.sites(skeleton.pose(mixed), skeleton.keypoints())) > TOUCH_M
        need = np.where(deep, np.minimum(need, share - SHARES[0] + SHARES[1]), need)
    half = max(1, round(EASE_S * fps))
    window = np.lib.stride_tricks.sliding_window_view(np.pad(need, 2 * half, mode="edge"), 2 * half + 1).min(axis=1)
    eased = np.convolve(window, np.hanning(2 * half + 3)[1:-1] / (half + 1.0), mode="valid")
    return relaxed + eased[:, None] * (angles - relaxed)
