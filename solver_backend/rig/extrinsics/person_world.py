"""Which way is up and where the floor is, from a person who stands and walks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.exchange.errors import NoDetections
from solver_backend.rig.extrinsics.person_scale import rest_keypoints
from solver_backend.types import JointSet
from solver_backend.types.shapes import Float

BODY_SIGMA = np.radians(4.0)
"""How far the direction from feet to shoulders is from gravity, over a take."""
FOOT_SIGMA_M = 0.02
"""How far a standing foot's keypoint is from its usual height."""
FRAMES_PER_STEP = 20
"""Frames that tell the same about the floor."""
LOWEST = 0.15
"""Share of a foot's heights that lie below the floor's, by noise."""
_ROUNDS = 40


@dataclass(frozen=True)
class Upright:
    """A rigid move into a world with Z up and the floor at zero: ``x_new = R x_old + t``."""

    R: Float[np.ndarray, "3 3"]
    """(3, 3)."""
    t: Float[np.ndarray, " 3"]
    """(3,) metres."""
    tilt_sigma: float
    """Standard deviation of the direction of gravity, radians."""
    walked_m: float
    """Root mean square of the feet's distance from their middle on the floor."""


def upright_from_person(points: Float[np.ndarray, "frames keypoints 3"], joint_set: JointSet) -> Upright:
    """Return the move that stands a person upright on the floor; she stands around the origin.

    Gravity is first the direction from ankles to shoulders where she stands tall. Her feet then tell the floor's plane,
    each kind of keypoint at a height of its own and the lowest 15 % of each below it by noise; the more she walked
    about, the more they count against the first.

    Args:
        points: (F, K, 3) metres, NaN where unknown.
        joint_set: names of the keypoints.

    Raises:
        NoDetections: shoulders and ankles are never seen together.

    Reference: Koenker and Bassett 1978 (quantile regression).
    """
    names = joint_set.keypoints
    middle = {part: _middle(points, names, part) for part in ("shoulder", "ankle")}
    tall = middle["shoulder"] - middle["ankle"]
    length = np.linalg.norm(tall, axis=-1)
    if not np.isfinite(length).any():
        raise NoDetections("Shoulders and ankles are never seen together, so nobody tells which way is up.")
    standing = length > 0.9 * np.nanquantile(length, 0.9)
    up = _median_direction(tall[standing] / length[standing, None])
    R = _turned_up(up)
    kinds = [k for k, n in enumerate(names) if n.endswith(("_heel", "_toe"))]
    kinds = kinds or [k for k, n in enumerate(names) if n.endswith("_ankle")]
    feet = points[:, kinds] @ R.T
    slope, sigma, walked = _floor(feet)
    R = _turned_up(np.array([-slope[0], -slope[1], 1.0])) @ R
    above_sole = _heights_at_rest(joint_set)[kinds]
    feet = points[:, kinds] @ R.T
    low = np.nanquantile(feet[..., 2], LOWEST, axis=0)
    centre = np.nanmedian((middle["ankle"] @ R.T)[:, :2], axis=0)
    return Upright(R, -np.array([*centre, float(np.nanmedian(low - above_sole))]), sigma, walked)


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


def _turned_up(up: np.ndarray) -> np.ndarray:
    """Return the least rotation that brings a direction to Z; half a turn about X where it points down."""
    up = up / np.linalg.norm(up)
    if up[2] < -0.999999:
        return np.diag([1.0, -1.0, -1.0])
    v = np.array([up[1], -up[0], 0.0])
    V = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return np.eye(3) + V + V @ V / (1.0 + up[2])


def _floor(feet: np.ndarray) -> tuple[np.ndarray, float, float]:
    """Return the floor's slope (2,), its standard deviation, and how far feet walked."""
    K = feet.shape[1]
    frame, kind = np.nonzero(np.isfinite(feet).all(-1))
    x = feet[frame, kind]
    where = x[:, :2] - np.median(x[:, :2], axis=0)
    A = np.concatenate([where, np.eye(K)[kind]], axis=1)
    prior = np.zeros(2 + K)
    prior[:2] = FRAMES_PER_STEP * K * FOOT_SIGMA_M**2 / BODY_SIGMA**2
    prior[2:] = 1e-9
    weight = np.ones(len(x))
    solution = np.zeros(2 + K)
    N = prior
    for _ in range(_ROUNDS):
        N = (A * weight[:, None]).T @ A + np.diag(prior)
        solution = np.linalg.solve(N, (A * weight[:, None]).T @ x[:, 2])
        residual = x[:, 2] - A @ solution
        share = np.where(residual > 0, LOWEST, 1.0 - LOWEST)
        weight = share * FOOT_SIGMA_M / np.maximum(np.abs(residual), 0.25 * FOOT_SIGMA_M)
    covariance = np.linalg.inv(N)[:2, :2] * FRAMES_PER_STEP * K * FOOT_SIGMA_M**2
    return (
        solution[:2],
        float(np.sqrt(np.trace(covariance) / 2)),
        float(np.sqrt((where**2).sum(1).mean())),
    )
