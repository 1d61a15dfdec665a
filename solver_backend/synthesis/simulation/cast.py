"""Somebody of a random shape who does what was recorded, on the floor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.body.body import Body, load_body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.body.landmarks import PosedLandmarks, pose_landmarks
from solver_backend.body.mesh import pose_mesh
from solver_backend.geometry.rotations import exp_so3
from solver_backend.types import NUM_BETAS, SMPL_JOINTS, JointSet

BETAS_SIGMA = 0.8
"""Spread of the drawn shapes, within the range of most people."""
FLOOR_S = 1.0
"""Within this time some sole stands on the floor."""
UPRIGHT = exp_so3(np.array([np.pi / 2, 0.0, 0.0]))
"""Y up to Z up."""


@dataclass(frozen=True)
class Take:
    """Recorded motion of F frames, Y up."""

    name: str
    rotations: np.ndarray
    """(F, 22, 3, 3) local rotations of the pelvis and joints 1..21 relative to the T-pose."""
    root: np.ndarray
    """(F, 3) metres, pelvis."""
    fps: float


@dataclass(frozen=True)
class Person:
    """A moving body; F frames."""

    body: Body
    betas: np.ndarray
    """(10,)."""
    orient: np.ndarray
    """(F, 3, 3) body to world, Z up."""
    local: np.ndarray
    """(F, 21, 3, 3)."""
    transl: np.ndarray
    """(F, 3) metres."""

    def landmarks(self, joint_set: JointSet, offsets: np.ndarray | None = None) -> PosedLandmarks:
        """Return the keypoints, moved by (K, 3) offsets in their rest frames."""
        points = keypoint_landmarks(self.body, joint_set)
        return pose_landmarks(
            self.body, points, self.betas, self.orient, self.local, self.transl, offsets=offsets
        )  # fmt: skip

    def skin(self, frames: np.ndarray) -> np.ndarray:
        """Return the (n, V, 3) vertices in these frames."""
        return pose_mesh(self.body, self.betas, self.orient[frames], self.local[frames], self.transl[frames])


def cast_person(take: Take, rng: np.random.Generator, body: Body | None = None) -> Person:
    """Return somebody of random shape who does what was recorded, on the floor."""
    body = body or load_body()
    betas = np.clip(BETAS_SIGMA * rng.normal(size=NUM_BETAS), -2.0, 2.0)
    orient, transl = _on_the_floor(body, betas, take)
    return Person(body, betas, orient, take.rotations[:, 1:], transl)


def _on_the_floor(body: Body, betas: np.ndarray, take: Take) -> tuple[np.ndarray, np.ndarray]:
    """Return root rotations and translations, Z up: steps scaled to the legs, the standing sole on the floor.

    The height is corrected by a slow curve, the running minimum of the soles over ``FLOOR_S`` smoothed over as long;
    ramps and stairs become flat, jumps shorter than that stay.
    """
    orient = UPRIGHT @ take.rotations[:, 0]
    rest = body.rest_joints(betas)
    legs = rest[0, 1] - rest[SMPL_JOINTS.index("left_ankle"), 1]
    recorded = float(np.percentile(take.root[:, 1], 90))
    path = (take.root - take.root[:1] * [1, 0, 1]) * (legs + 0.08) / max(recorded, 0.5)
    transl = path @ UPRIGHT.T - rest[0]
    soles = keypoint_landmarks(body, JointSet.BODY_25)
    points = pose_landmarks(body, soles, betas, orient, take.rotations[:, 1:], transl).points
    feet = [k for k, name in enumerate(JointSet.BODY_25.keypoints) if name.endswith(("_toe", "_heel"))]
    transl[:, 2] -= running_floor(points[:, feet, 2].min(axis=1), max(1, round(FLOOR_S * take.fps))) - 0.01
    return orient, transl


def running_floor(height: np.ndarray, frames: int) -> np.ndarray:
    """Return (F,) the least height within ``frames`` around each frame, smoothed by a Gaussian of half that length."""
    near = np.lib.stride_tricks.sliding_window_view(np.pad(height, frames // 2, mode="edge"), 2 * (frames // 2) + 1)
    lowest = np.pad(near.min(axis=1), 2 * frames, mode="edge")
    kernel = np.exp(-0.5 * (np.arange(-2 * frames, 2 * frames + 1) / (0.5 * frames)) ** 2)
    return np.convolve(lowest, kernel / kernel.sum(), mode="valid")
