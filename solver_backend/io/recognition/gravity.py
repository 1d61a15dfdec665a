"""Estimate the up direction and the floor from a person who stands and walks."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from solver_backend.agreement.evidence import BLOCKS, MOST_ROUNDS, SIGMAS
from solver_backend.agreement.person_tracks import BRIDGE_S
from solver_backend.agreement.reading import MIN_POINTS
from solver_backend.body.body import load_body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.exchange.errors import NoDetections
from solver_backend.geometry.rotations import skew
from solver_backend.io.recognition.marker_up_axis import FLOOR_M
from solver_backend.io.recognition.person_scale import rest_keypoints
from solver_backend.types import JointSet
from solver_backend.types.shapes import Float

SEGMENTS = (
    (0.2175, "shoulder", "hip", 0.45), (0.0271, "shoulder", "elbow", 0.577), (0.0223, "elbow", "wrist", 0.68),
    (0.1416, "hip", "knee", 0.41), (0.0570, "knee", "ankle", 0.55), (0.034, "hip", "shoulder", 1.5),
)  # fmt: skip
"""Mass fraction per side, end points, and relative position of the centre of mass between them. The head's centre of
mass is beyond the end. Hands count with forearms, feet with shanks (de Leva 1996, mean of both sexes)."""


@dataclass(frozen=True)
class BalancePoints:
    """Centre of mass and supporting points in F frames, in the unit of the input points."""

    centre: Float[np.ndarray, "frames 3"]  # (F, 3) centre of mass.
    feet: Float[np.ndarray, "2 frames 3"]  # (2, F, 3) supporting points of the left and right sole.
    leg: float  # Length of a leg from hip to ankle.


def body_points(points: Float[np.ndarray, "frames keypoints 3"], joint_set: JointSet) -> BalancePoints:
    """Return the centre of mass and the soles in the F frames that show both. F may be 0."""
    at = {name: points[:, k] for k, name in enumerate(joint_set.keypoints)}
    both = {part: 0.5 * (at[f"left_{part}"] + at[f"right_{part}"]) for part in ("hip", "ankle")}
    parts = [(share, side, a, b, place) for share, a, b, place in SEGMENTS for side in ("left", "right")]
    total = sum(share * ((1 - place) * at[f"{s}_{a}"] + place * at[f"{s}_{b}"]) for share, s, a, b, place in parts)
    feet = np.stack([_sole(at, side, both["hip"] - both["ankle"]) for side in ("left", "right")])
    centre = np.asarray(total) / sum(share for share, *_ in parts)
    known = np.isfinite(centre).all(-1) & np.isfinite(feet).all((0, -1))
    legs = [
        np.linalg.norm(at[f"{s}_{a}"] - at[f"{s}_{b}"], axis=-1)[known]
        for s in ("left", "right")
        for a, b in (("hip", "knee"), ("knee", "ankle"))
    ]
    leg = float(np.median(sum(legs)) / 2) if known.any() else float("nan")
    return BalancePoints(centre[known], feet[:, known], leg)


def _sole(at: dict[str, np.ndarray], side: str, up: np.ndarray) -> np.ndarray:
    """Return (F, 3) supporting points of a sole between heel and toe."""
    ankle, heel, toe = (at.get(f"{side}_{part}") for part in ("ankle", "heel", "big_toe"))
    assert ankle is not None
    across = at["left_hip"] - at["right_hip"]
    ahead = np.cross(across, up)
    ahead = ahead / np.maximum(np.linalg.norm(ahead, axis=-1, keepdims=True), 1e-9)
    guess = ankle + _ankle_to_sole_m() * ahead
    if heel is None or toe is None:
        return guess
    middle = 0.5 * (heel + toe)
    return np.where(np.isfinite(middle), middle, guess)


@cache
def _ankle_to_sole_m() -> float:
    """Return the distance in metres from the ankle forward to the middle of the sole, of the mean body."""
    body, names = load_body(), JointSet.BODY_25.keypoints
    rest = rest_keypoints(body, keypoint_landmarks(body, JointSet.BODY_25), np.zeros(10))
    ankle, heel, toe = (rest[names.index(f"left_{part}"), 2] for part in ("ankle", "heel", "big_toe"))
    return float(0.5 * (heel + toe) - ankle)


def leaning(body: BalancePoints, up: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "frames 3"]:
    """Return horizontal offsets of the centre of mass from its support, as slopes.

    The support is the lower foot. If the other foot is nearly as low, it is the point between both that is nearest to
    the projected centre of mass. The deviation of up affects the heights of the feet.
    """
    level = np.eye(3) - np.outer(up, up)
    left_lower = ((body.feet[0] - body.feet[1]) @ up < 0)[:, None]
    left, right = body.feet
    low, other = np.where(left_lower, left, right), np.where(left_lower, right, left)
    gap = other - low
    flat = gap @ level
    square = (flat**2).sum(-1)
    carries = np.exp(-0.5 * (gap @ up) ** 2 / (2.0 * FOOT_SIGMA_M**2 + np.tan(TILT_SIGMA) ** 2 * square))
    along = np.clip((((body.centre - low) @ level) * flat).sum(-1) / np.maximum(square, 1e-6), 0.0, 1.0)
    above = body.centre - low - np.minimum(along, carries)[:, None] * gap
    height = above @ up
    standing = height > body.leg  # The centre of mass of a standing person is above the hips.
    return (above @ level)[standing] / height[standing, None]


def mean_variance(values: Float[np.ndarray, "frames axes"]) -> float:
    """Return the variance per axis of the mean of correlated values, from the means of time blocks."""
    means = np.array([part.mean(axis=0) for part in np.array_split(values, min(BLOCKS, len(values)))])
    return float(means.var(axis=0, ddof=1).mean() / len(means))


BODY_SIGMA = np.radians(12.0)
"""Standard deviation per axis (radians) over a take of the angle between gravity and the direction from ankles to
shoulders. If the angle varies more, the person runs, leaps or tumbles, and the frames show little about gravity."""
TILT_SIGMA = np.radians(4.0)
"""Standard deviation per axis (radians) in a long take of the angle between gravity and the mean direction from support
to centre of mass, and of the roll of cameras set up by eye. A smaller tilt is usual, and is not corrected."""
FLOOR_SIGMA = np.radians(1.5)  # Standard deviation of a floor from level, in addition to foot keypoint noise.
FOOT_SIGMA_M = 0.02  # Standard deviation of a standing foot's keypoint height, metres.
LOWEST = 0.15  # Fraction of a foot's heights below the floor because of noise.
_Z = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Witness:
    """A source's estimate of up as a normal distribution of ``u``, where ``(u, 1)`` is up in a person's world."""

    precision: Float[np.ndarray, "2 2"]  # (2, 2) inverse covariance.
    weighted: Float[np.ndarray, " 2"]  # (2,) precision times mean.

    def less_precise(self, sigma: float) -> Witness:
        """Add a standard deviation per axis."""
        share = np.linalg.inv(np.eye(2) + sigma**2 * self.precision)
        return Witness(share @ self.precision, share @ self.weighted)

    def gain(self, direction: np.ndarray, old: np.ndarray) -> float:
        """Return by how many squared deviations a unit vector (3,) is nearer to the mean than an old one."""
        new, old = direction[:2], old[:2]
        return float(old @ self.precision @ old - new @ self.precision @ new - 2.0 * (old - new) @ self.weighted)


@dataclass(frozen=True)
class Upright:
    """A rigid transform to a world with Z up and the floor at zero: ``x_new = R x_old + t``."""

    R: Float[np.ndarray, "3 3"]  # (3, 3).
    t: Float[np.ndarray, " 3"]  # (3,) translation in metres.
    tilt_sigma: float  # RMS angle between the world's up and gravity, radians.
    walked_m: float  # RMS distance of the feet from their median position on the floor, metres.
    balance: Witness  # Evidence of the centre of mass, in the world after ``R``.
    floor: Witness  # The same of the floor under the feet.


def upright_from_person(points: Float[np.ndarray, "frames keypoints 3"], joint_set: JointSet, fps: float) -> Upright:
    """Return the transform that places a person upright on the floor.

    Gravity is estimated from three sources, each with its covariance:

    * the direction from ankles to shoulders of a person at full height
    * the centre of mass, which is on average above its support
    * the floor, a plane with an offset for each foot keypoint, where noise puts the lowest 15 % of each below the plane

    The more the person walks, the more weight the floor has. The balance decides for a person who stays in one place.

    Args:
        points: (F, K, 3) keypoints in metres, NaN where unknown.
        fps: frames per second. Neighbouring frames are correlated.

    Raises:
        NoDetections: shoulders and ankles are never visible together.

    Reference: Koenker and Bassett 1978 (quantile regression); de Leva 1996 (segments' masses).
    """
    names = joint_set.keypoints
    middle = {part: middle_of(points, names, part) for part in ("shoulder", "ankle")}
    tall = middle["shoulder"] - middle["ankle"]
    length = np.linalg.norm(tall, axis=-1)
    if not np.isfinite(length).any():
        raise NoDetections("Shoulders and ankles are never visible at the same time, so the up direction is unknown.")
    standing = length > 0.9 * np.nanquantile(length, 0.9)
    up = trunk = _median_direction(tall[standing] / length[standing, None])
    body, feet = body_points(points, joint_set), points[:, foot_keypoints(joint_set)]
    alike = max(1.0, BRIDGE_S * fps) * feet.shape[1]
    known = np.isfinite(feet).all(-1)
    feet, kind = feet[known], np.nonzero(known)[1]

    def improve(up: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return the refined up direction, the foot weights, the rotation from ``up`` to Z, and the precision."""
        R = turn_to_z(up)
        seen: np.ndarray = R @ trunk
        floor, weight = _floor(feet @ R.T, kind, weight, alike)
        balance = _balance(body, R)[0]
        precision = np.eye(2) / BODY_SIGMA**2 + balance.precision + floor.precision
        slope = np.linalg.solve(precision, seen[:2] / seen[2] / BODY_SIGMA**2 + balance.weighted + floor.weighted)
        new = R.T @ np.array([*slope * min(1.0, BODY_SIGMA / max(float(np.linalg.norm(slope)), 1e-9)), 1.0])
        return new / np.linalg.norm(new), weight, R, precision

    weight = np.ones(len(kind))
    for _ in range(MOST_ROUNDS):
        up, weight, *_ = improve(up, weight)
    up, weight, R, precision = improve(up, weight)
    (balance, spread), (floor, _) = _balance(body, R), _floor(feet @ R.T, kind, weight, alike)
    # Trunk and balance contradict each other if they differ by more than the RMS angle over both axes.
    apart = float(np.arccos(np.clip(up @ trunk, -1.0, 1.0)))
    doubt = max(0.0, apart - np.sqrt(2.0) * BODY_SIGMA), max(0.0, spread - BODY_SIGMA)
    sigma = float(np.sqrt(np.trace(np.linalg.inv(precision)) + sum(2.0 * d**2 for d in doubt)))
    walked = float(np.sqrt((((feet - np.median(feet, axis=0)) @ R[:2].T) ** 2).sum(1).mean()))
    centre = np.nanmedian((middle["ankle"] @ R.T)[:, :2], axis=0)
    t = -np.array([*centre, floor_height(points @ R.T, joint_set)])
    return Upright(R, t, sigma, walked, balance, floor.less_precise(FLOOR_SIGMA))


def _balance(body: BalancePoints, R: np.ndarray) -> tuple[Witness, float]:
    """Return the evidence of the mean lean in the world after ``R``, and the deviation of the lean per axis.

    A person who is rarely on the feet shows no balance.
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
    """Return the evidence of a plane under the (N, 3) foot points, and their new weights in the quantile regression.

    Each of the (N,) kinds of keypoints has its own height above the plane.
    """

    def centred(weight: np.ndarray) -> np.ndarray:
        total = np.maximum(np.bincount(kind, weight), 1e-9)
        return feet - np.stack([np.bincount(kind, weight * x) / total for x in feet.T], axis=-1)[kind]

    above = centred(weight)[:, 2]
    weight = np.where(above > 0, LOWEST, 1.0 - LOWEST) * FOOT_SIGMA_M / np.maximum(np.abs(above), 0.25 * FOOT_SIGMA_M)
    x = centred(weight)
    information = (x[:, :2] * weight[:, None]).T @ x / (alike * FOOT_SIGMA_M**2)
    return Witness(information[:, :2], -information[:, 2]), weight


def foot_keypoints(joint_set: JointSet) -> list[int]:
    """Return the columns of heels and toes, or of ankles if the joint set has none of these."""
    names = joint_set.keypoints
    kinds = [k for k, n in enumerate(names) if n.endswith(("_heel", "_toe"))]
    return kinds or [k for k, n in enumerate(names) if n.endswith("_ankle")]


def floor_height(points: Float[np.ndarray, "frames keypoints 3"], joint_set: JointSet) -> float:
    """Return the floor's height in metres under an upright person's feet."""
    kinds = foot_keypoints(joint_set)
    heights = points[:, kinds, 2]
    low = np.full(len(kinds), np.nan)
    seen = np.isfinite(heights).any(axis=0)
    low[seen] = np.nanquantile(heights[:, seen], LOWEST, axis=0)
    body = load_body()
    at_rest = rest_keypoints(body, keypoint_landmarks(body, joint_set), np.zeros(10))[kinds, 1]
    return float(np.nanmedian(low - (at_rest - float(body.v_template[:, 1].min()))))


def middle_of(points: np.ndarray, names: tuple[str, ...], part: str) -> np.ndarray:
    """Return the (F, 3) midpoints between the left and right keypoint of a body part."""
    return 0.5 * (points[:, names.index(f"left_{part}")] + points[:, names.index(f"right_{part}")])


def _median_direction(directions: np.ndarray) -> np.ndarray:
    """Return the geometric median of unit vectors, normalised (Weiszfeld's iterations)."""
    mean = directions.mean(0)
    for _ in range(MOST_ROUNDS):
        weight = 1.0 / np.maximum(np.linalg.norm(directions - mean, axis=1), 1e-3)
        mean = (directions * weight[:, None]).sum(0) / weight.sum()
    return mean / np.linalg.norm(mean)


def turn_to_z(up: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "3 3"]:
    """Return the smallest rotation from a direction to Z."""
    up = up / np.linalg.norm(up)
    if up[2] < -0.999999:
        return np.diag([1.0, -1.0, -1.0])
    V = skew(np.array([up[1], -up[0], 0.0]))
    return np.eye(3) + V + V @ V / (1.0 + up[2])


SURE = 5.0
"""Smallest sum of the sources without the strongest one, and of the cameras' roll against a lying person. Level takes
reach 1.2, slopes and stairs 3.8. Chosen on five takes, and confirmed on two others (docs/research-log/agreement.md).
"""


@dataclass(frozen=True)
class Level:
    """Evidence from a person and the cameras about the world's up direction and floor."""

    turn: Float[np.ndarray, "3 3"]  # (3, 3) rotation from the calibration's world to the upright world.
    tilt: float  # Angle between the calibration's Z and the estimated up, radians.
    sigma: float  # RMS error of the estimated up, radians.
    balance: float  # Gain of the estimated up over the calibration's Z for the balance, in squared deviations.
    floor: float  # The same for the floor under the feet. Only this value detects a slope or stairs.
    cameras: float  # The same for the cameras' roll.
    floor_m: float  # Height of the floor in the calibration's world, assumed level, metres.
    floor_upright_m: float  # The same in the rotated world.

    @property
    def is_tilted(self) -> bool:
        """True if the calibration's world is certainly tilted."""
        least, second, _ = sorted((self.balance, self.floor, self.cameras))
        return self.could_be_tilted and least + second >= SURE and least > -SURE

    @property
    def could_be_tilted(self) -> bool:
        """True if the tilt exceeds its uncertainty."""
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
    """Measure the tilt and floor of a world from keypoints (F, K, 3) in metres and rotations R of cameras.

    Raises:
        NoDetections: shoulders and ankles are never visible together.
    """
    upright = upright_from_person(points, joint_set, fps)
    up, sigma = _add_cameras(upright, R)
    turn, tilt = turn_to_z(up), float(np.arccos(np.clip(up[2], -1.0, 1.0)))
    old, new = upright.R[:, 2], upright.R @ up
    floor = upright.floor.gain(new, old) if old[2] > 0.1 else 0.0  # otherwise the calibration's floor is a wall
    floors = floor_height(points, joint_set), floor_height(points @ turn.T, joint_set)
    return Level(turn, tilt, sigma, upright.balance.gain(new, old), floor, roll_gain(R, up), *floors)


def _add_cameras(upright: Upright, R: np.ndarray) -> tuple[np.ndarray, float]:
    """Combine the up direction of person and cameras. Return it with its standard deviation (radians).

    For a level image, the horizontal image axis ``(h, v)`` satisfies ``h · u + v = 0``, with up ``(u, 1)`` in the
    person's world. Cameras that roll far beyond ``TILT_SIGMA`` get a low weight.
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
    """Return the gain of ``up`` over the world's Z in explaining the cameras' roll.

    In upright images x is horizontal. A roll counts up to ``SIGMAS``, so that one rolled camera does not decide.
    """

    def rolls(direction: np.ndarray) -> np.ndarray:
        return np.minimum(np.arcsin(np.clip(np.abs(R[:, 0] @ direction), 0.0, 1.0)) / TILT_SIGMA, SIGMAS)

    return float((rolls(_Z) ** 2 - rolls(up) ** 2).sum())
