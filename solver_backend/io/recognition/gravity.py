"""Which way is up and where the floor is, from a person who stands and walks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.exchange.errors import NoDetections
from solver_backend.io.recognition.balance import BalancePoints, body_points, independent_count, leaning
from solver_backend.io.recognition.person_scale import rest_keypoints
from solver_backend.types import JointSet
from solver_backend.types.shapes import Float

BODY_SIGMA = np.radians(12.0)
"""How far the direction from ankles to shoulders is from gravity, over a take, per axis."""
BALANCE_SIGMA = np.radians(3.5)
"""How far the direction from the support to the centre of mass is from gravity in the mean of a long take, per axis:
what a person accelerates, and what keypoints make of the body's masses."""
LEANS_SIGMA = np.radians(12.0)
"""Frames that lean by more are of somebody who runs, leaps or turns over, which shows little."""
APART_SIGMAS = 1.4
"""Beyond this many of ``BODY_SIGMA`` body and balance contradict each other, and neither is believed."""
FOOT_SIGMA_M = 0.02
"""How far a standing foot's keypoint is from its usual height."""
FRAMES_PER_STEP, FPS = 14, 30.0
"""Frames that show the same of the floor, at so many a second."""
LOWEST = 0.15
"""Share of a foot's heights that lie below the floor's, by noise."""
_ROUNDS, _PASSES = 40, 5
_LARGEST_STEP = 0.15
"""Change of the floor's slope in one step at most, radians; chosen by hand."""
_SURE_TILT = np.radians(4.0)
"""Tilt that counts as sure at least, radians; chosen by hand."""


@dataclass(frozen=True)
class Upright:
    """A rigid move into a world with Z up and the floor at zero: ``x_new = R x_old + t``."""

    R: Float[np.ndarray, "3 3"]
    """(3, 3)."""
    t: Float[np.ndarray, " 3"]
    """(3,) metres."""
    tilt_sigma: float
    """Root mean square of the angle between the world's up and gravity that is to be expected, radians."""
    walked_m: float
    """Root mean square of the feet's distance from their middle on the floor."""


def upright_from_person(
    points: Float[np.ndarray, "frames keypoints 3"], joint_set: JointSet, fps: float = FPS
) -> Upright:
    """Return the move that stands a person upright on the floor; the person then stands around the origin.

    Three witnesses of gravity, each with its covariance: the direction from ankles to shoulders of a person who stands
    tall; the centre of mass, which in the mean is above what carries it; and the floor, a plane on which each kind of
    keypoint of the feet has a height of its own, the lowest 15 % of each below it by noise. The more the person walks
    about, the more the floor counts; for somebody who only balances in one place, the balance counts.

    Args:
        points: (F, K, 3) metres, NaN where unknown.
        joint_set: names of the keypoints.
        fps: frames a second; the nearer they are, the more of them show the same.

    Raises:
        NoDetections: shoulders and ankles are never seen together.

    Reference: Koenker and Bassett 1978 (quantile regression); de Leva 1996 (segments' masses).
    """
    names = joint_set.keypoints
    middle = {part: _middle(points, names, part) for part in ("shoulder", "ankle")}
    tall = middle["shoulder"] - middle["ankle"]
    length = np.linalg.norm(tall, axis=-1)
    if not np.isfinite(length).any():
        raise NoDetections("Shoulders and ankles are never seen together, so the up direction is unknown.")
    standing = length > 0.9 * np.nanquantile(length, 0.9)
    trunk = _median_direction(tall[standing] / length[standing, None])
    kinds = foot_keypoints(joint_set)
    R, sigma, walked = _gravity(points[:, kinds], trunk, body_points(points, joint_set), fps)
    centre = np.nanmedian((middle["ankle"] @ R.T)[:, :2], axis=0)
    return Upright(R, -np.array([*centre, floor_height(points @ R.T, joint_set)]), sigma, walked)


def foot_keypoints(joint_set: JointSet) -> list[int]:
    """Return the columns of heels and toes, of ankles where there are none."""
    names = joint_set.keypoints
    kinds = [k for k, n in enumerate(names) if n.endswith(("_heel", "_toe"))]
    return kinds or [k for k, n in enumerate(names) if n.endswith("_ankle")]


def floor_height(points: Float[np.ndarray, "frames keypoints 3"], joint_set: JointSet) -> float:
    """Return the height in metres of the floor under feet of a person upright along Z."""
    kinds = foot_keypoints(joint_set)
    low = np.nanquantile(points[:, kinds, 2], LOWEST, axis=0)
    return float(np.nanmedian(low - _heights_at_rest(joint_set)[kinds]))


def _heights_at_rest(joint_set: JointSet) -> np.ndarray:
    """Return (K,) how high keypoints are above the sole of the mean body at rest, metres."""
    body = load_body()
    return rest_keypoints(body, keypoint_landmarks(body, joint_set), np.zeros(10))[:, 1] - float(
        body.v_template[:, 1].min()
    )


def _middle(points: np.ndarray, names: tuple[str, ...], part: str) -> np.ndarray:
    return 0.5 * (points[:, names.index(f"left_{part}")] + points[:, names.index(f"right_{part}")])


def _median_direction(directions: np.ndarray) -> np.ndarray:
    """Return the unit vector with the least sum of distances to others (Weiszfeld's iterations)."""
    mean = directions.mean(0)
    for _ in range(_ROUNDS):
        weight = 1.0 / np.maximum(np.linalg.norm(directions - mean, axis=1), 1e-3)
        mean = (directions * weight[:, None]).sum(0) / weight.sum()
    return mean / np.linalg.norm(mean)


def turn_to_z(up: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "3 3"]:
    """Return the least rotation that brings a direction to Z; half a turn about X where it points down."""
    up = up / np.linalg.norm(up)
    if up[2] < -0.999999:
        return np.diag([1.0, -1.0, -1.0])
    v = np.array([up[1], -up[0], 0.0])
    V = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return np.eye(3) + V + V @ V / (1.0 + up[2])


def _gravity(feet: np.ndarray, trunk: np.ndarray, body: BalancePoints, fps: float) -> tuple[np.ndarray, float, float]:
    """Return the turn that brings up to Z, the angle it may be off by, and how far feet walked.

    Slopes are of the plane across gravity: up is ``(-a, -b, 1)``.
    """
    up, sigma, walked = trunk, BODY_SIGMA, 0.0
    spread = 0.0
    for number in range(_PASSES + 1):
        R = turn_to_z(up)
        seen = R @ trunk
        information = np.eye(2) / BODY_SIGMA**2
        wanted = information @ (-seen[:2] / seen[2])
        if number > 0 and len(body.centre) > 4:
            lean = (leaning(body, up, max(_SURE_TILT, 1.5 * sigma)) @ R.T)[:, :2]
            if len(lean) > 4:
                mean, spread = robust_mean(lean)
                variance = BALANCE_SIGMA**2 + spread**2 / independent_count(lean)
                information, wanted = information + np.eye(2) / variance, wanted - mean / variance
        slope, covariance, walked = fit_floor(feet @ R.T, np.linalg.solve(information, wanted), information, fps)
        step = float(np.linalg.norm(slope))
        slope = slope * min(1.0, _LARGEST_STEP / max(step, 1e-9))
        new = R.T @ np.array([-slope[0], -slope[1], 1.0])
        up, sigma = new / np.linalg.norm(new), float(np.sqrt(np.trace(covariance) / 2))
    apart = float(np.arccos(np.clip(up @ trunk, -1.0, 1.0)))
    doubt = max(0.0, apart - APART_SIGMAS * BODY_SIGMA), max(0.0, spread - LEANS_SIGMA)
    return turn_to_z(up), float(np.sqrt(2.0 * sigma**2 + sum(2.0 * d**2 for d in doubt))), walked


def robust_mean(lean: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the mean of (N, 2) slopes, those far from their median counting less, and their spread per axis."""
    far = np.linalg.norm(lean - np.median(lean, axis=0), axis=1)
    scale = max(0.05, 1.26 * float(np.median(far)))
    weight = 1.0 / np.maximum(far / scale, 1.0)
    return (lean * weight[:, None]).sum(0) / weight.sum(), float(np.sqrt((far**2).mean() / 2))


def fit_floor(
    feet: np.ndarray, wanted: np.ndarray, information: np.ndarray, fps: float = FPS
) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the floor's slope (2,), its covariance, and how far feet walked; a slope is wanted with an information."""
    K = feet.shape[1]
    frame, kind = np.nonzero(np.isfinite(feet).all(-1))
    x = feet[frame, kind]
    where = x[:, :2] - np.median(x[:, :2], axis=0)
    A = np.concatenate([where, np.eye(K)[kind]], axis=1)
    alike = max(1.0, FRAMES_PER_STEP * fps / FPS) * K * FOOT_SIGMA_M**2
    H = 1e-9 * np.eye(2 + K)
    H[:2, :2] = alike * information
    g = np.concatenate([alike * information @ wanted, np.zeros(K)])
    weight = np.ones(len(x))
    solution, N = np.zeros(2 + K), H
    for _ in range(_ROUNDS):
        N = (A * weight[:, None]).T @ A + H
        solution = np.linalg.solve(N, (A * weight[:, None]).T @ x[:, 2] + g)
        residual = x[:, 2] - A @ solution
        share = np.where(residual > 0, LOWEST, 1.0 - LOWEST)
        weight = share * FOOT_SIGMA_M / np.maximum(np.abs(residual), 0.25 * FOOT_SIGMA_M)
    return solution[:2], np.linalg.inv(N)[:2, :2] * alike, float(np.sqrt((where**2).sum(1).mean()))
