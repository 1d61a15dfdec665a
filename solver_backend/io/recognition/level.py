"""Whether a calibration's world is level, by witnesses that do not depend on each other.

A person's balance, the floor under the feet and the cameras, which are set up without roll, each compare the
calibration's Z with the direction that the person shows to be up. Somebody who lies, leans or climbs convinces one of
them at most; the others contradict.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.io.recognition.balance import body_points, independent_count, leaning
from solver_backend.io.recognition.gravity import (
    BALANCE_SIGMA,
    FPS,
    Upright,
    fit_floor,
    floor_height,
    foot_keypoints,
    robust_mean,
    turn_to_z,
    upright_from_person,
)
from solver_backend.types import Cameras, JointSet
from solver_backend.types.shapes import Float

FLOOR_SIGMA = np.radians(1.5)
"""How far a floor is from level, and how much keypoints of feet tilt it beyond what their scatter shows."""
ROLL_SIGMA = np.radians(4.0)
"""Roll of cameras that are set up by eye. Those of ``shared/data/multiview/pose2sim`` roll by 2.5, 2.6, 12 and 24°."""
WITNESS_MOST = 25.0
"""What one witness can add, in squared standard deviations: five of them."""
CONTRADICTS = 4.0
"""Two standard deviations: a witness counts from here on, for or against."""
SURE, SURE_WITHOUT_FLOOR = 16.0, 9.0
"""What all witnesses together must show: four standard deviations; three where the calibration's floor is not under the
feet either, so that its world was put down by nobody."""
OFF_FLOOR_M = 0.15
"""From here on feet do not stand on a floor."""
LEAST_TILT = np.radians(4.0)
"""A smaller tilt is within what people and floors do; it stays."""
_ROUNDS = 10
BELOW_M = 0.25
"""Nobody stands so far below a floor; slopes and stairs that lead down stay within it near the origin."""


@dataclass(frozen=True)
class Level:
    """What a person and cameras show of the world's up and floor."""

    turn: Float[np.ndarray, "3 3"]
    """(3, 3) from the calibration's world to the one in which person and cameras are upright."""
    tilt: float
    """Angle between the calibration's Z and that up, radians."""
    sigma: float
    """Root mean square of the angle by which that up is off, radians."""
    balance: float
    """How much better the person's up explains the balance than the calibration's Z does, in squared standard
    deviations; negative where it is worse, 0 where nothing is known."""
    floor: float
    """The same of the floor under the feet."""
    cameras: float
    """The same of the cameras' roll."""
    floor_m: float
    """Height of the floor in the calibration's world, taken as level, metres."""
    floor_upright_m: float
    """The same in the turned world."""

    @property
    def is_tilted(self) -> bool:
        """Whether the calibration's world is tilted beyond doubt."""
        witnesses = self.balance, self.floor, self.cameras
        has_floor = abs(self.floor_m) < OFF_FLOOR_M
        agree = sum(value >= CONTRADICTS for value in witnesses) >= 2 and min(witnesses) > -CONTRADICTS
        return self.could_be_tilted and agree and sum(witnesses) >= (SURE if has_floor else SURE_WITHOUT_FLOOR)

    @property
    def could_be_tilted(self) -> bool:
        """Whether the tilt is more than the person's stance leaves open."""
        return self.tilt > max(LEAST_TILT, 2.0 * self.sigma)

    @property
    def is_above_feet(self) -> bool:
        """Whether a level floor at z = 0 would be above the feet."""
        return not self.could_be_tilted and self.floor_m < -BELOW_M


def measure_level(
    points: Float[np.ndarray, "frames keypoints 3"], joint_set: JointSet, cameras: Cameras, fps: float = FPS
) -> Level:
    """Return what the witnesses show.

    Args:
        points: (F, K, 3) metres in the calibration's world, NaN where unknown.
        joint_set: names of the keypoints.
        cameras: C cameras in that world.
        fps: frames a second.

    Raises:
        NoDetections: shoulders and ankles are never seen together.
    """
    upright = upright_from_person(points, joint_set, fps)
    up, sigma = _add_cameras(upright, cameras.R)
    turn = turn_to_z(up)
    z, turned = turn[:, 2], points @ turn.T
    return Level(
        turn, float(np.arccos(np.clip(z[2], -1.0, 1.0))), sigma, _balance(turned, joint_set, z, upright.tilt_sigma),
        _floor(turned[:, foot_keypoints(joint_set)], z, fps), roll_gain(cameras.R, turn[2]),
        floor_height(points, joint_set), floor_height(turned, joint_set),
    )  # fmt: skip


def _add_cameras(upright: Upright, R: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the up that person and cameras show together, and the angle it may be off by.

    In the person's world up is ``(-a, -b, 1)`` with slopes of the variance ``σ²/2`` each; the axis ``(h, v)`` across
    a picture that is level has ``h · (a, b) = v``. The cameras' spread is learned with the weight of as many rolls of
    ``ROLL_SIGMA`` as there are cameras, and a camera that rolls far beyond it fades out.
    """
    across = R[:, 0] @ upright.R.T
    h, v = across[:, :2], across[:, 2]
    prior = np.eye(2) / (0.5 * upright.tilt_sigma**2)
    slope, weight, variance = np.zeros(2), np.full(len(v), ROLL_SIGMA**-2), ROLL_SIGMA**2
    for _ in range(_ROUNDS):
        precision = prior + (h * weight[:, None]).T @ h
        slope = np.linalg.solve(precision, (h * weight[:, None]).T @ v)
        rolls = v - h @ slope
        variance = float((ROLL_SIGMA**2 + np.minimum(rolls**2, ROLL_SIGMA**2).mean()) / 2)
        weight = 1.0 / (variance * (1.0 + (rolls / (2.0 * ROLL_SIGMA)) ** 2) ** 2)
    up = upright.R.T @ np.array([-slope[0], -slope[1], 1.0])
    covariance = np.linalg.inv(prior + (h * weight[:, None]).T @ h)
    return up / np.linalg.norm(up), float(np.sqrt(np.trace(covariance)))


def _balance(points: np.ndarray, joint_set: JointSet, z: np.ndarray, tilt_sigma: float) -> float:
    """Compare the mean lean of the centre of mass over the feet with the new up and with ``z``, in the turned world."""
    body = body_points(points, joint_set)
    if len(body.centre) <= 4:
        return 0.0
    lean = leaning(body, np.array([0.0, 0.0, 1.0]), max(LEAST_TILT, 1.5 * tilt_sigma))[:, :2]
    if len(lean) <= max(4, len(body.centre) // 2):  # who is seldom on the feet shows no balance
        return 0.0
    mean, spread = robust_mean(lean)
    up = np.array([*mean, 1.0]) / np.sqrt(1.0 + mean @ mean)
    sigma = np.sqrt(BALANCE_SIGMA**2 + spread**2 / independent_count(lean))
    return _gain(_angle(up, z) / sigma, _angle(up, np.array([0.0, 0.0, 1.0])) / sigma)


def _floor(feet: np.ndarray, z: np.ndarray, fps: float) -> float:
    """Compare the plane under the feet with both, in the turned world: its slope along the tilt, by its covariance."""
    if z[2] < 0.1:  # the calibration's floor would be a wall
        return 0.0
    slope, covariance, _ = fit_floor(feet, np.zeros(2), 1e-6 * np.eye(2), fps)
    precision = np.linalg.inv(covariance + FLOOR_SIGMA**2 * np.eye(2))
    wrong = slope + z[:2] / z[2]  # the plane across z has the slope -(zx, zy) / zz
    return _gain(float(np.sqrt(wrong @ precision @ wrong)), float(np.sqrt(slope @ precision @ slope)))


def roll_gain(R: Float[np.ndarray, "cameras 3 3"], up: Float[np.ndarray, " 3"]) -> float:
    """Return how much better ``up`` explains the roll of cameras than the world's Z, in squared standard deviations.

    People stand upright in pictures, portrait ones too, so x lies across. A camera that rolls under both, as one does
    whose pictures are turned, does not decide: each counts up to 3 standard deviations.

    Args:
        R: (C, 3, 3) world to camera.
        up: (3,) unit vector of the world.
    """

    def rolls(direction: np.ndarray) -> np.ndarray:
        return np.minimum(np.arcsin(np.clip(np.abs(R[:, 0] @ direction), 0.0, 1.0)) / ROLL_SIGMA, 3.0)

    gain = rolls(np.array([0.0, 0.0, 1.0])) ** 2 - rolls(up) ** 2
    return float(np.clip(gain.sum(), -WITNESS_MOST, WITNESS_MOST))


def _gain(old: float, new: float) -> float:
    return float(np.clip(old**2 - new**2, -WITNESS_MOST, WITNESS_MOST))


def _angle(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.arccos(np.clip(a @ b, -1.0, 1.0)))
