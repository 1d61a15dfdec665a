"""Estimate the up direction and the floor from a person who stands and walks."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from solver_backend.agreement.evidence import BLOCKS, BODY_SIGMA, BOUND, MOST_ROUNDS, SIGMAS
from solver_backend.agreement.person_tracks import BRIDGE_S
from solver_backend.agreement.reading import MIN_POINTS
from solver_backend.biomechanics.support import SIGMA_M
from solver_backend.body.body import load_body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.exchange.errors import NoDetections
from solver_backend.geometry.alignment import turn_to_z
from solver_backend.geometry.arrays import quantile
from solver_backend.geometry.small_matrices import unit
from solver_backend.io.recognition.marker_up_axis import FLOOR_M
from solver_backend.io.recognition.person_scale import rest_keypoints
from solver_backend.types import JointSet
from solver_backend.types.shapes import Float

SEGMENTS = (
    (0.2175, "shoulder", "hip", 0.45), (0.0271, "shoulder", "elbow", 0.577), (0.0223, "elbow", "wrist", 0.68),
    (0.1416, "hip", "knee", 0.41), (0.0570, "knee", "ankle", 0.55), (0.034, "hip", "shoulder", 1.5),
)  # fmt: skip
"""Mass fraction of a segment per side, its ends, and the relative position of its centre of mass between them (de Leva
1996, mean of both sexes). Forearms include hands, and shanks include feet. The last segment is the head with neck."""


@dataclass(frozen=True)
class BalancePoints:
    """Centre of mass and soles of a person in F frames, in metres."""

    centre: Float[np.ndarray, "frames 3"]
    feet: Float[np.ndarray, "2 frames 3"]  # Middle of the left and the right sole.
    leg: float  # Length of a leg from hip to ankle.


def body_points(points: Float[np.ndarray, "frames keypoints 3"], joint_set: JointSet) -> BalancePoints:
    """Estimate the centre of mass and the soles in all frames that show both."""
    at = {name: points[:, k] for k, name in enumerate(joint_set.keypoints)}
    both = {part: 0.5 * (at[f"left_{part}"] + at[f"right_{part}"]) for part in ("hip", "ankle")}
    parts = [(share, side, a, b, place) for share, a, b, place in SEGMENTS for side in ("left", "right")]
    total = sum(share * ((1 - place) * at[f"{s}_{a}"] + place * at[f"{s}_{b}"]) for share, s, a, b, place in parts)
    feet = np.stack([_sole(at, side, both["hip"] - both["ankle"]) for side in ("left", "right")])
    centre = np.asarray(total) / sum(share for share, *_ in parts)
    known = np.isfinite(centre).all(-1) & np.isfinite(feet).all((0, -1))
    bones = [at[f"{s}_{a}"] - at[f"{s}_{b}"] for _, s, a, b, _ in parts if a in ("hip", "knee") and b != "shoulder"]
    legs = np.linalg.norm(bones, axis=-1)[:, known].sum(axis=0) / 2
    return BalancePoints(centre[known], feet[:, known], float(np.median(legs)) if len(legs) else np.nan)


def _sole(at: dict[str, np.ndarray], side: str, up: np.ndarray) -> np.ndarray:
    ankle, heel, toe = (at.get(f"{side}_{part}") for part in ("ankle", "heel", "big_toe"))
    assert ankle is not None
    guess = ankle + _ankle_to_sole_m() * unit(np.cross(at["left_hip"] - at["right_hip"], up))
    middle = guess if heel is None or toe is None else 0.5 * (heel + toe)
    return np.where(np.isfinite(middle), middle, guess)


@cache
def _ankle_to_sole_m() -> float:
    body, names = load_body(), JointSet.BODY_25.keypoints
    rest = rest_keypoints(body, keypoint_landmarks(body, JointSet.BODY_25), np.zeros(10))
    ankle, heel, toe = (rest[names.index(f"left_{part}"), 2] for part in ("ankle", "heel", "big_toe"))
    return float(0.5 * (heel + toe) - ankle)


def leaning(body: BalancePoints, up: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "frames 3"]:
    """Return the slopes (F, 3) of the line from the support to the centre of mass, in frames with a standing person.

    The support is the lower foot. If the other foot is nearly as low, given the uncertainty of the up direction, the
    support is the point between the feet that is nearest to the centre of mass.
    """
    level, (left, right) = np.eye(3) - np.outer(up, up), body.feet
    left_lower = ((left - right) @ up < 0)[:, None]
    low, gap = np.where(left_lower, left, right), np.where(left_lower, right - left, left - right)
    flat = gap @ level
    square = (flat**2).sum(-1)
    carries = np.exp(-0.5 * (gap @ up) ** 2 / (2.0 * SIGMA_M**2 + np.tan(TILT_SIGMA) ** 2 * square))
    along = np.clip((((body.centre - low) @ level) * flat).sum(-1) / np.maximum(square, 1e-6), 0.0, 1.0)
    above = body.centre - low - np.minimum(along, carries)[:, None] * gap
    height = above @ up
    standing = height > body.leg  # The centre of mass of a standing person is above the hips.
    return (above @ level)[standing] / height[standing, None]


def mean_variance(values: Float[np.ndarray, "frames axes"]) -> float:
    """Estimate the variance per axis of the mean of (F, A) values that are correlated over time."""
    means = np.array([part.mean(axis=0) for part in np.array_split(values, min(BLOCKS, len(values)))])
    return float(means.var(axis=0, ddof=1).mean() / len(means))


TILT_SIGMA = np.radians(4.0)
"""Standard deviation per axis (radians) of the mean direction from the support to the centre of mass, and of the roll
of cameras that were set up by eye. A smaller tilt is usual, and is not corrected."""
FLOOR_SIGMA = np.radians(1.5)  # Standard deviation of a real floor from level, radians.
LOWEST = 0.15  # Fraction of the heights of a foot that noise places below the floor.
_Z = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Witness:
    """Up direction ``(u, 1)`` from one source, as a normal distribution of ``u`` in a person's world."""

    precision: Float[np.ndarray, "2 2"]  # Inverse covariance.
    weighted: Float[np.ndarray, " 2"]  # Precision times mean.

    def gain(self, direction: np.ndarray, old: np.ndarray) -> float:
        """Return how much the squared Mahalanobis distance decreases if up is ``direction`` instead of ``old`` (3,)."""
        new, old = direction[:2], old[:2]
        return float(old @ self.precision @ old - new @ self.precision @ new - 2.0 * (old - new) @ self.weighted)


@dataclass(frozen=True)
class Upright:
    """Rigid transform to a world with Z up and the floor at 0: ``x_new = R x_old + t``."""

    R: Float[np.ndarray, "3 3"]
    t: Float[np.ndarray, " 3"]  # Metres.
    tilt_sigma: float  # RMS error of the estimated up direction, radians.
    walked_m: float  # RMS distance of the feet from their median position on the floor, metres.
    balance: Witness  # Up direction from the centre of mass, in the world after ``R``.
    floor: Witness  # Up direction from the floor under the feet, in the same world.


def upright_from_person(points: Float[np.ndarray, "frames keypoints 3"], joint_set: JointSet, fps: float) -> Upright:
    """Estimate the transform that places a person upright on the floor.

    The up direction is estimated from three sources, each with its covariance:

    * the direction from the ankles to the shoulders of a person at full height
    * the centre of mass, which is on average above its support
    * a plane under the feet, at a separate height for each foot keypoint, with 15 % of the noisy points below it

    The floor has more weight if the person walks farther, and the balance if the person stays in one place.

    Args:
        points: (F, K, 3) keypoints in metres, NaN where unknown.
        fps: frames per second. The errors of neighbouring frames are correlated.

    Raises:
        NoDetections: shoulders and ankles are never visible together.

    Reference: Koenker and Bassett 1978 (quantile regression); de Leva 1996 (segments' masses).
    """
    up = trunk = trunk_direction(points, joint_set)
    if not np.isfinite(up).all():
        raise NoDetections("Shoulders and ankles are never visible at the same time, so the up direction is unknown.")
    body, feet = body_points(points, joint_set), points[:, foot_keypoints(points, joint_set)]
    alike = max(1.0, BRIDGE_S * fps) * feet.shape[1]
    known = np.isfinite(feet).all(-1)
    feet, kind = feet[known], np.nonzero(known)[1]

    weight, R, precision = np.ones(len(kind)), np.eye(3), np.eye(2)
    for _ in range(MOST_ROUNDS):
        R = turn_to_z(up)
        seen: np.ndarray = R @ trunk
        floor, weight = _floor(feet @ R.T, kind, weight, alike)
        balance = _balance(body, R)[0]
        precision = np.eye(2) / BODY_SIGMA**2 + balance.precision + floor.precision
        slope = np.linalg.solve(precision, seen[:2] / seen[2] / BODY_SIGMA**2 + balance.weighted + floor.weighted)
        up = R.T @ unit(np.array([*slope * min(1.0, BODY_SIGMA / max(float(np.linalg.norm(slope)), 1e-9)), 1.0]))
    (balance, spread), (floor, _) = _balance(body, R), _floor(feet @ R.T, kind, weight, alike)
    # Trunk and balance contradict each other if they differ by more than the RMS angle over both axes.
    apart = float(np.arccos(np.clip(up @ trunk, -1.0, 1.0)))
    doubt = max(0.0, apart - np.sqrt(2.0) * BODY_SIGMA), max(0.0, spread - BODY_SIGMA)
    sigma = float(np.sqrt(np.trace(np.linalg.inv(precision)) + sum(2.0 * d**2 for d in doubt)))
    walked = float(np.sqrt((((feet - np.median(feet, axis=0)) @ R[:2].T) ** 2).sum(1).mean()))
    centre = np.nanmedian((middle_of(points, joint_set.keypoints, "ankle") @ R.T)[:, :2], axis=0)
    t = -np.array([*centre, floor_height(points @ R.T, joint_set)])
    share = np.linalg.inv(np.eye(2) + FLOOR_SIGMA**2 * floor.precision)  # a floor is not exactly level
    return Upright(R, t, sigma, walked, balance, Witness(share @ floor.precision, share @ floor.weighted))


def _balance(body: BalancePoints, R: np.ndarray) -> tuple[Witness, float]:
    """Estimate the up direction from the mean lean of the person. Return the deviation of the lean per axis too.

    The up direction is in the world after ``R``. Its precision is 0 if the person rarely stands.
    """
    lean = (leaning(body, R[2]) @ R.T)[:, :2] if len(body.centre) > MIN_POINTS else np.empty((0, 2))
    if len(lean) <= max(MIN_POINTS, len(body.centre) // 2):
        return Witness(np.zeros((2, 2)), np.zeros(2)), 0.0
    far = np.linalg.norm(lean - np.median(lean, axis=0), axis=1)
    weight = 1.0 / np.maximum(far / max(0.05, 1.26 * float(np.median(far))), 1.0)
    mean = (lean * weight[:, None]).sum(0) / weight.sum()
    variance = TILT_SIGMA**2 + mean_variance(lean)
    return Witness(np.eye(2) / variance, mean / variance), float(np.sqrt((far**2).mean() / 2))


def _floor(feet: np.ndarray, kind: np.ndarray, weight: np.ndarray, alike: float) -> tuple[Witness, np.ndarray]:
    """Estimate the up direction from a plane under N foot points. Return new weights for the quantile regression.

    Each kind of keypoint has its own height above the plane. ``alike`` points count as one, because their errors are
    correlated.
    """

    def centred(weight: np.ndarray) -> np.ndarray:
        total = np.maximum(np.bincount(kind, weight), 1e-9)
        return feet - np.stack([np.bincount(kind, weight * x) / total for x in feet.T], axis=-1)[kind]

    above = centred(weight)[:, 2]
    weight = np.where(above > 0, LOWEST, 1.0 - LOWEST) * SIGMA_M / np.maximum(np.abs(above), 0.25 * SIGMA_M)
    x = centred(weight)
    information = (x[:, :2] * weight[:, None]).T @ x / (alike * SIGMA_M**2)
    return Witness(information[:, :2], -information[:, 2]), weight


def foot_keypoints(points: Float[np.ndarray, "frames keypoints 3"], joint_set: JointSet) -> list[int]:
    """Return the columns of heels and toes, or of the ankles if no heel or toe is visible."""
    names = joint_set.keypoints
    kinds = [k for k, n in enumerate(names) if n.endswith(("_heel", "_toe"))]
    return kinds if np.isfinite(points[:, kinds]).any() else [k for k, n in enumerate(names) if n.endswith("_ankle")]


def floor_height(points: Float[np.ndarray, "frames keypoints 3"], joint_set: JointSet) -> float:
    """Estimate the height in metres of the floor under an upright person's feet, NaN if no foot is known."""
    kinds = foot_keypoints(points, joint_set)
    low = quantile(points[:, kinds, 2], LOWEST, axis=0)
    body = load_body()
    at_rest = rest_keypoints(body, keypoint_landmarks(body, joint_set), np.zeros(10))[kinds, 1]
    return float(quantile(low - (at_rest - body.v_template[:, 1].min()), 0.5, axis=0))


def trunk_direction(points: Float[np.ndarray, "frames keypoints 3"], joint_set: JointSet) -> Float[np.ndarray, " 3"]:
    """Return the median direction from the ankles to the shoulders of a person at full height, NaN if unknown."""
    ankle, shoulder = (middle_of(points, joint_set.keypoints, part) for part in ("ankle", "shoulder"))
    length = np.linalg.norm(shoulder - ankle, axis=-1)
    at_full_height = length > 0.9 * quantile(length, 0.9, axis=0)
    return unit(quantile(unit(shoulder - ankle)[at_full_height], 0.5, axis=0))


def middle_of(points: np.ndarray, names: tuple[str, ...], part: str) -> np.ndarray:
    """Return the (F, 3) midpoints of the left and the right keypoint of a body part."""
    return 0.5 * (points[:, names.index(f"left_{part}")] + points[:, names.index(f"right_{part}")])


@dataclass(frozen=True)
class Level:
    """Up direction and floor of a calibration's world, estimated from a person and the cameras."""

    turn: Float[np.ndarray, "3 3"]  # Rotation from the calibration's world to the upright world.
    tilt: float  # Angle between the calibration's Z and the estimated up direction, radians.
    sigma: float  # RMS error of the estimated up direction, radians.
    gains: tuple[float, float, float]
    """Decrease of the squared Mahalanobis distance of balance, floor and camera roll from Z to the estimated direction.
    On a slope or stairs only the floor has a gain."""
    floor_m: float  # Height of the floor in the calibration's world, assumed level, metres.
    floor_upright_m: float  # Height of the floor in the upright world, metres.

    @property
    def is_tilted(self) -> bool:
        """True if the calibration's world is certainly tilted.

        The sum of the two smaller gains reaches 1.2 in level takes, and 3.8 on slopes and stairs.
        """
        least, second, _ = sorted(self.gains)
        return self.could_be_tilted and least + second >= BOUND and least > -BOUND

    @property
    def could_be_tilted(self) -> bool:
        """True if the tilt is larger than usual, and larger than its uncertainty."""
        return self.tilt > max(TILT_SIGMA, 2.0 * self.sigma)

    @property
    def is_above_feet(self) -> bool:
        """True if a level floor at z = 0 would be above the feet."""
        return not self.could_be_tilted and self.floor_m < -FLOOR_M


def measure_level(
    points: Float[np.ndarray, "frames keypoints 3"],
    joint_set: JointSet,
    R: Float[np.ndarray, "cameras 3 3"],
    fps: float,
) -> Level:
    """Estimate the tilt and the floor of a world from 3D keypoints in metres and the rotations R of C cameras.

    Raises:
        NoDetections: shoulders and ankles are never visible together.
    """
    upright = upright_from_person(points, joint_set, fps)
    up, sigma = _add_cameras(upright, R)
    turn, tilt = turn_to_z(up), float(np.arccos(np.clip(up[2], -1.0, 1.0)))
    old, new = upright.R[:, 2], upright.R @ up
    floor = upright.floor.gain(new, old) if old[2] > 0.1 else 0.0  # otherwise the calibration's floor is a wall
    floors = floor_height(points, joint_set), floor_height(points @ turn.T, joint_set)
    return Level(turn, tilt, sigma, (upright.balance.gain(new, old), floor, roll_gain(R, up)), *floors)


def _add_cameras(upright: Upright, R: np.ndarray) -> tuple[np.ndarray, float]:
    """Combine the up direction of the person with the roll of the cameras. Return the RMS error in radians too.

    The horizontal axis ``(h, v)`` of a level image satisfies ``h · u + v = 0``, with up ``(u, 1)`` in the person's
    world. Cameras that roll far beyond ``TILT_SIGMA`` get a low weight.
    """
    across = R[:, 0] @ upright.R.T
    h, v = across[:, :2], across[:, 2]
    slope, precision = np.zeros(2), np.eye(2)
    for _ in range(MOST_ROUNDS):
        weight = 1.0 / (TILT_SIGMA + ((v + h @ slope) / 2.0) ** 2 / TILT_SIGMA) ** 2
        precision = np.eye(2) / (0.5 * upright.tilt_sigma**2) + (h * weight[:, None]).T @ h
        slope = -np.linalg.solve(precision, (h * weight[:, None]).T @ v)
    up = upright.R.T @ np.array([*slope, 1.0])
    return up / np.linalg.norm(up), float(np.sqrt(np.trace(np.linalg.inv(precision))))


def roll_gain(R: Float[np.ndarray, "cameras 3 3"], up: Float[np.ndarray, " 3"]) -> float:
    """Return how much the sum of squared camera rolls decreases if up is ``up`` instead of Z.

    Rolls are in units of ``TILT_SIGMA``. A roll counts up to ``SIGMAS``, so that a single rolled camera does not
    decide.
    """

    def rolls(direction: np.ndarray) -> np.ndarray:
        return np.minimum(np.arcsin(np.clip(np.abs(R[:, 0] @ direction), 0.0, 1.0)) / TILT_SIGMA, SIGMAS)

    return float((rolls(_Z) ** 2 - rolls(up) ** 2).sum())
