"""Where a person's weight is and what carries it: over a while, one stands above the other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.types import JointSet
from solver_backend.types.shapes import Float

SEGMENTS = (
    (0.435, "shoulder", "hip", 0.45), (0.0271, "shoulder", "elbow", 0.577), (0.0223, "elbow", "wrist", 0.68),
    (0.1416, "hip", "knee", 0.41), (0.0570, "knee", "ankle", 0.55),
)  # fmt: skip
"""Share of the body's mass (of the trunk at once, else of one side's), ends, and where between them it lies; the hand
goes with the forearm and the foot with the shank (de Leva 1996, mean of both sexes)."""
HEAD_MASS = 0.068
CARRIES_AT = 0.45
"""Where between heel and toe a sole carries who stands still; in the middle, recorded people who stand seem to lean."""
AHEAD_M = 0.05
"""How far in front of the ankle a sole carries, where neither heels nor toes are known."""
CARRIES_M = 0.04
"""A foot so much above the other one still carries with a weight of ``exp(-1/2)``, where up is known well."""
LEAST_HEIGHT = 0.7
"""Of the centre of mass above the support, in lengths of the leg, for somebody who is on their feet."""


@dataclass(frozen=True)
class BalancePoints:
    """What is needed of F frames in which all of it is known, in the points' unit."""

    centre: Float[np.ndarray, "frames 3"]
    """(F, 3) centre of mass."""
    feet: Float[np.ndarray, "2 frames 3"]
    """(2, F, 3) where the left and the right sole carry."""
    leg: float
    """Length of a leg, hip to ankle."""


def body_points(points: Float[np.ndarray, "frames keypoints 3"], joint_set: JointSet) -> BalancePoints:
    """Return centre of mass and soles of the frames in which they are known; F may be 0."""
    at = {name: points[:, k] for k, name in enumerate(joint_set.keypoints)}
    both = {part: 0.5 * (at[f"left_{part}"] + at[f"right_{part}"]) for part in ("shoulder", "hip", "ankle")}
    total, mass = np.zeros_like(both["hip"]), 0.0
    for share, a, b, place in SEGMENTS:
        for side in ("left", "right"):
            one = share / 2 if (a, b) == ("shoulder", "hip") else share
            total = total + one * ((1 - place) * at[f"{side}_{a}"] + place * at[f"{side}_{b}"])
            mass += one
    trunk = both["shoulder"] - both["hip"]
    total, mass = total + HEAD_MASS * (both["shoulder"] + 0.5 * trunk), mass + HEAD_MASS
    feet = np.stack([_sole(at, side, both["hip"] - both["ankle"]) for side in ("left", "right")])
    centre = total / mass
    known = np.isfinite(centre).all(-1) & np.isfinite(feet).all((0, -1))
    legs = [
        np.linalg.norm(at[f"{s}_{a}"] - at[f"{s}_{b}"], axis=-1)[known]
        for s in ("left", "right")
        for a, b in (("hip", "knee"), ("knee", "ankle"))
    ]
    leg = float(np.median(sum(legs)) / 2) if known.any() else float("nan")
    return BalancePoints(centre[known], feet[:, known], leg)


def _sole(at: dict[str, np.ndarray], side: str, up: np.ndarray) -> np.ndarray:
    """Return (F, 3) where a sole carries: between heel and toe, else a little before the ankle."""
    ankle, heel, toe = (at.get(f"{side}_{part}") for part in ("ankle", "heel", "big_toe"))
    assert ankle is not None
    across = at["left_hip"] - at["right_hip"]
    ahead = np.cross(across, up)
    ahead = ahead / np.maximum(np.linalg.norm(ahead, axis=-1, keepdims=True), 1e-9)
    guess = ankle + AHEAD_M * ahead
    if heel is None or toe is None:
        return guess
    carrying = (1.0 - CARRIES_AT) * heel + CARRIES_AT * toe
    return np.where(np.isfinite(carrying), carrying, guess)


def leaning(body: BalancePoints, up: Float[np.ndarray, " 3"], tilt_sigma: float) -> Float[np.ndarray, "frames 3"]:
    """Return how far the centre of mass is from above its support, as slopes ``d / h``, of frames on the feet.

    The support is the lower foot or, as the other one is nearly as low, the point between both that is nearest to
    below the centre of mass. How low is low depends on how well up is known: feet that are far apart are at unequal
    heights where it is tilted.

    Args:
        body: of F frames.
        up: unit vector, as known so far.
        tilt_sigma: how well, radians.
    """
    level = np.eye(3) - np.outer(up, up)
    left_lower = ((body.feet[0] - body.feet[1]) @ up < 0)[:, None]
    low, other = np.where(left_lower, *body.feet), np.where(left_lower, *body.feet[::-1])
    gap = other - low
    flat = gap @ level
    square = (flat**2).sum(-1)
    carries = np.exp(-0.5 * (gap @ up) ** 2 / (CARRIES_M**2 + np.tan(tilt_sigma) ** 2 * square))
    along = np.clip((((body.centre - low) @ level) * flat).sum(-1) / np.maximum(square, 1e-6), 0.0, 1.0)
    above = body.centre - low - np.minimum(along, carries)[:, None] * gap
    height = above @ up
    standing = height > LEAST_HEIGHT * body.leg
    return (above @ level)[standing] / height[standing, None]


def independent_count(values: Float[np.ndarray, "frames axes"]) -> float:
    """Return how many independent values so many correlated ones are worth, by their autocorrelation."""
    values = values - values.mean(0)
    count, variance = len(values), float((values**2).sum(-1).mean()) if len(values) else 0.0
    if count < 4 or variance < 1e-12:
        return 1.0
    size = 2 ** int(np.ceil(np.log2(2 * count)))
    spectrum = np.abs(np.fft.rfft(values, size, axis=0)) ** 2
    alike = np.fft.irfft(spectrum, size, axis=0)[: count // 2].sum(-1) / (count * variance)
    below = np.flatnonzero(alike < 0.05)
    first = int(below[0]) if len(below) else len(alike)
    return max(1.0, count / (1.0 + 2.0 * float(alike[1:first].sum())))
