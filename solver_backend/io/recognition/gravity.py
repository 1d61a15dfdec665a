"""Estimate the up direction and the floor from a person who stands and walks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.agreement.evidence import BLOCKS, MOST_ROUNDS
from solver_backend.agreement.person_tracks import BRIDGE_S
from solver_backend.body.body import load_body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.exchange.errors import NoDetections
from solver_backend.geometry.rotations import skew
from solver_backend.io.recognition.person_scale import rest_keypoints
from solver_backend.types import Cameras, JointSet
from solver_backend.types.shapes import Float

SEGMENTS = (
    (0.2175, "shoulder", "hip", 0.45), (0.0271, "shoulder", "elbow", 0.577), (0.0223, "elbow", "wrist", 0.68),
    (0.1416, "hip", "knee", 0.41), (0.0570, "knee", "ankle", 0.55), (0.034, "hip", "shoulder", 1.5),
)  # fmt: skip
"""Mass fraction per side, end points, and relative position of the centre of mass between them. The head's centre of
mass is beyond the end. Hands count with forearms, feet with shanks (de Leva 1996, mean of both sexes)."""
CARRIES_AT = 0.45
"""Relative position between heel and toe that supports a standing person. With 0.5, recorded people seem to lean."""
CARRIES_M = 0.04
"""Height in metres above the other foot at which a foot supports with weight ``exp(-1/2)`` if up is well known, and
distance from the ankle forward to the support if neither heels nor toes are known."""
LEAST_HEIGHT = 0.7  # Smallest height of a standing person's centre of mass above the feet, in leg lengths.


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
    guess = ankle + CARRIES_M * ahead
    if heel is None or toe is None:
        return guess
    carrying = (1.0 - CARRIES_AT) * heel + CARRIES_AT * toe
    return np.where(np.isfinite(carrying), carrying, guess)


def leaning(body: BalancePoints, up: Float[np.ndarray, " 3"], tilt_sigma: float) -> Float[np.ndarray, "frames 3"]:
    """Return horizontal offsets of the centre of mass from its support, as slopes.

    The support is the lower foot. If the other foot is nearly as low, it is the point between both that is nearest to
    the projected centre of mass. The tolerance grows with the uncertainty of up, which affects the heights of the feet.
    """
    level = np.eye(3) - np.outer(up, up)
    left_lower = ((body.feet[0] - body.feet[1]) @ up < 0)[:, None]
    left, right = body.feet
    low, other = np.where(left_lower, left, right), np.where(left_lower, right, left)
    gap = other - low
    flat = gap @ level
    square = (flat**2).sum(-1)
    carries = np.exp(-0.5 * (gap @ up) ** 2 / (CARRIES_M**2 + np.tan(tilt_sigma) ** 2 * square))
    along = np.clip((((body.centre - low) @ level) * flat).sum(-1) / np.maximum(square, 1e-6), 0.0, 1.0)
    above = body.centre - low - np.minimum(along, carries)[:, None] * gap
    height = above @ up
    standing = height > LEAST_HEIGHT * body.leg
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
APART_SIGMAS = 1.4
"""Multiple of ``BODY_SIGMA`` beyond which trunk and balance contradict each other, so that up is uncertain."""
FOOT_SIGMA_M = 0.02  # Standard deviation of a standing foot's keypoint height, metres.
FPS = 30.0  # Frame rate if unknown.
LOWEST = 0.15  # Fraction of a foot's heights below the floor because of noise.
_PASSES = 5
_Z = np.array([0.0, 0.0, 1.0])
_LARGEST_STEP = 0.15  # Largest change of the floor's slope per iteration, radians, chosen by hand.


@dataclass(frozen=True)
class Upright:
    """A rigid transform to a world with Z up and the floor at zero: ``x_new = R x_old + t``."""

    R: Float[np.ndarray, "3 3"]  # (3, 3).
    t: Float[np.ndarray, " 3"]  # (3,) translation in metres.
    tilt_sigma: float  # RMS angle between the world's up and gravity, radians.
    walked_m: float  # RMS distance of the feet from their median position on the floor, metres.


def upright_from_person(
    points: Float[np.ndarray, "frames keypoints 3"], joint_set: JointSet, fps: float = FPS
) -> Upright:
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
    trunk = _median_direction(tall[standing] / length[standing, None])
    kinds = foot_keypoints(joint_set)
    R, sigma, walked = _gravity(points[:, kinds], trunk, body_points(points, joint_set), fps)
    centre = np.nanmedian((middle["ankle"] @ R.T)[:, :2], axis=0)
    return Upright(R, -np.array([*centre, floor_height(points @ R.T, joint_set)]), sigma, walked)


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


def _gravity(feet: np.ndarray, trunk: np.ndarray, body: BalancePoints, fps: float) -> tuple[np.ndarray, float, float]:
    """Return the rotation from up to Z, its deviation (radians), and the walked distance.

    With slopes a and b of the plane across gravity, up is ``(-a, -b, 1)``.
    """
    up, sigma, walked = trunk, BODY_SIGMA, 0.0
    spread = 0.0
    for number in range(_PASSES + 1):
        R = turn_to_z(up)
        seen: np.ndarray = R @ trunk
        information = np.eye(2) / BODY_SIGMA**2
        wanted = information @ (-seen[:2] / seen[2])
        if number > 0 and len(body.centre) > 4:
            lean = (leaning(body, up, max(TILT_SIGMA, 1.5 * sigma)) @ R.T)[:, :2]
            if len(lean) > 4:
                mean, spread = robust_mean(lean)
                variance = TILT_SIGMA**2 + mean_variance(lean)
                information, wanted = information + np.eye(2) / variance, wanted - mean / variance
        slope, covariance, walked = fit_floor(feet @ R.T, np.linalg.solve(information, wanted), information, fps)
        step = float(np.linalg.norm(slope))
        slope = slope * min(1.0, _LARGEST_STEP / max(step, 1e-9))
        new = R.T @ np.array([-slope[0], -slope[1], 1.0])
        up, sigma = new / np.linalg.norm(new), float(np.sqrt(np.trace(covariance) / 2))
    apart = float(np.arccos(np.clip(up @ trunk, -1.0, 1.0)))
    doubt = max(0.0, apart - APART_SIGMAS * BODY_SIGMA), max(0.0, spread - BODY_SIGMA)
    return turn_to_z(up), float(np.sqrt(2.0 * sigma**2 + sum(2.0 * d**2 for d in doubt))), walked


def robust_mean(lean: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the robust mean of (N, 2) slopes, and their standard deviation per axis."""
    far = np.linalg.norm(lean - np.median(lean, axis=0), axis=1)
    scale = max(0.05, 1.26 * float(np.median(far)))
    weight = 1.0 / np.maximum(far / scale, 1.0)
    return (lean * weight[:, None]).sum(0) / weight.sum(), float(np.sqrt((far**2).mean() / 2))


def fit_floor(
    feet: np.ndarray, wanted: np.ndarray, information: np.ndarray, fps: float = FPS
) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the floor's slope (2,), its covariance, and the distance that feet walked."""
    K = feet.shape[1]
    frame, kind = np.nonzero(np.isfinite(feet).all(-1))
    x = feet[frame, kind]
    where = x[:, :2] - np.median(x[:, :2], axis=0)
    A = np.concatenate([where, np.eye(K)[kind]], axis=1)
    alike = max(1.0, BRIDGE_S * fps) * K * FOOT_SIGMA_M**2
    H = 1e-9 * np.eye(2 + K)
    H[:2, :2] = alike * information
    g = np.concatenate([alike * information @ wanted, np.zeros(K)])
    weight = np.ones(len(x))
    solution, N = np.zeros(2 + K), H
    for _ in range(MOST_ROUNDS):
        N = (A * weight[:, None]).T @ A + H
        solution = np.linalg.solve(N, (A * weight[:, None]).T @ x[:, 2] + g)
        residual = x[:, 2] - A @ solution
        share = np.where(residual > 0, LOWEST, 1.0 - LOWEST)
        weight = share * FOOT_SIGMA_M / np.maximum(np.abs(residual), 0.25 * FOOT_SIGMA_M)
    return solution[:2], np.linalg.inv(N)[:2, :2] * alike, float(np.sqrt((where**2).sum(1).mean()))


FLOOR_SIGMA = np.radians(1.5)  # Standard deviation of a floor from level, in addition to foot keypoint noise.
WITNESS_MOST = 25.0  # Largest contribution of one source, in squared standard deviations.
SURE = 5.0
"""Smallest sum of the sources without the strongest one, and of the cameras' roll against a lying person. Level takes
reach 1.2, slopes and stairs 3.8. Chosen on five takes, and confirmed on two others (docs/research-log/agreement.md).
"""
OFF_FLOOR_M, BELOW_M = 0.15, 0.25
"""Smallest distance in metres from the feet to a floor that they do not touch, and smallest depth of the feet below a
wrong floor. Slopes and stairs are less deep near the origin."""


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
        witnesses = self.balance, self.floor, self.cameras
        agreed = sum(witnesses) - max(witnesses) >= SURE and min(witnesses) > -SURE
        return self.could_be_tilted and agreed

    @property
    def could_be_tilted(self) -> bool:
        """True if the tilt exceeds its uncertainty."""
        return self.tilt > max(TILT_SIGMA, 2.0 * self.sigma)

    @property
    def is_above_feet(self) -> bool:
        """True if a level floor at z = 0 would be above the feet."""
        return not self.could_be_tilted and self.floor_m < -BELOW_M


def measure_level(
    points: Float[np.ndarray, "frames keypoints 3"], joint_set: JointSet, cameras: Cameras, fps: float = FPS
) -> Level:
    """Measure the tilt and floor of a world from keypoints (F, K, 3) in metres and cameras.

    Raises:
        NoDetections: shoulders and ankles are never visible together.
    """
    upright = upright_from_person(points, joint_set, fps)
    up, sigma = _add_cameras(upright, cameras.R)
    turn = turn_to_z(up)
    z, turned = turn[:, 2], points @ turn.T
    balance = _balance(turned, joint_set, z, upright.tilt_sigma)
    floor = _floor(turned[:, foot_keypoints(joint_set)], z, fps)
    floors = floor_height(points, joint_set), floor_height(turned, joint_set)
    return Level(turn, _angle(up, _Z), sigma, balance, floor, roll_gain(cameras.R, up), *floors)


def _add_cameras(upright: Upright, R: np.ndarray) -> tuple[np.ndarray, float]:
    """Combine the up direction of person and cameras. Return it with its standard deviation (radians).

    In the person's world, up is ``(-a, -b, 1)``, and each slope has the variance ``σ²/2``. For a level image, the
    horizontal image axis ``(h, v)`` satisfies ``h · (a, b) = v``. The roll variance is estimated with a prior of
    ``TILT_SIGMA``. Cameras that roll far beyond it get a low weight.
    """
    across = R[:, 0] @ upright.R.T
    h, v = across[:, :2], across[:, 2]
    prior = np.eye(2) / (0.5 * upright.tilt_sigma**2)
    slope, weight, variance = np.zeros(2), np.full(len(v), TILT_SIGMA**-2), TILT_SIGMA**2
    for _ in range(MOST_ROUNDS):
        precision = prior + (h * weight[:, None]).T @ h
        slope = np.linalg.solve(precision, (h * weight[:, None]).T @ v)
        rolls = v - h @ slope
        variance = float((TILT_SIGMA**2 + np.minimum(rolls**2, TILT_SIGMA**2).mean()) / 2)
        weight = 1.0 / (variance * (1.0 + (rolls / (2.0 * TILT_SIGMA)) ** 2) ** 2)
    up = upright.R.T @ np.array([-slope[0], -slope[1], 1.0])
    covariance = np.linalg.inv(prior + (h * weight[:, None]).T @ h)
    return up / np.linalg.norm(up), float(np.sqrt(np.trace(covariance)))


def _balance(points: np.ndarray, joint_set: JointSet, z: np.ndarray, tilt_sigma: float) -> float:
    """Return the gain of the new up over ``z`` in explaining the mean lean."""
    body = body_points(points, joint_set)
    if len(body.centre) <= 4:
        return 0.0
    lean = leaning(body, _Z, max(TILT_SIGMA, 1.5 * tilt_sigma))[:, :2]
    if len(lean) <= max(4, len(body.centre) // 2):  # a person who is rarely on the feet shows no balance
        return 0.0
    mean, _ = robust_mean(lean)
    up = np.array([*mean, 1.0]) / np.sqrt(1.0 + mean @ mean)
    sigma = np.sqrt(TILT_SIGMA**2 + mean_variance(lean))
    return _gain(_angle(up, z) / sigma, _angle(up, _Z) / sigma)


def _floor(feet: np.ndarray, z: np.ndarray, fps: float) -> float:
    """Return how much better the new up than ``z`` explains the floor slope under the feet."""
    if z[2] < 0.1:  # the calibration's floor would be vertical
        return 0.0
    slope, covariance, _ = fit_floor(feet, np.zeros(2), 1e-6 * np.eye(2), fps)
    precision = np.linalg.inv(covariance + FLOOR_SIGMA**2 * np.eye(2))
    wrong = slope + z[:2] / z[2]  # the plane perpendicular to z has the slope -(zx, zy) / zz
    return _gain(float(np.sqrt(wrong @ precision @ wrong)), float(np.sqrt(slope @ precision @ slope)))


def roll_gain(R: Float[np.ndarray, "cameras 3 3"], up: Float[np.ndarray, " 3"]) -> float:
    """Return the gain of ``up`` over the world's Z in explaining the cameras' roll.

    In upright images x is horizontal. A roll counts up to 3 deviations, so that one rolled camera does not decide.
    """

    def rolls(direction: np.ndarray) -> np.ndarray:
        return np.minimum(np.arcsin(np.clip(np.abs(R[:, 0] @ direction), 0.0, 1.0)) / TILT_SIGMA, 3.0)

    gain = rolls(_Z) ** 2 - rolls(up) ** 2
    return float(np.clip(gain.sum(), -WITNESS_MOST, WITNESS_MOST))


def _gain(old: float, new: float) -> float:
    return float(np.clip(old**2 - new**2, -WITNESS_MOST, WITNESS_MOST))


def _angle(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.arccos(np.clip(a @ b, -1.0, 1.0)))
