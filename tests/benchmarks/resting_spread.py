"""How far joints at rest are from where people have them: ``python -m tests.benchmarks.resting_spread``.

Prints by anchor and joint the standard deviations along the anchor bone's axes that ``SPREAD_MM`` holds, and how many
of the recorded joints lie inside the 50, 80 and 95 % ellipsoids. Needs the recordings (MOCAP_SHARED_DATA).
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.body.resting_posture import PARTS, rest_rotations
from solver_backend.fitters.partial_body.resting_spread import SPREAD_MM
from solver_backend.io.motions.recorded_clip import body_rotations, read_clip
from solver_backend.training.data.shoulder_rhythm import with_shoulder_rhythm
from solver_backend.types import SMPL_JOINTS
from tests.benchmarks.comparison.judgement import HELD
from tests.support.recordings import recordings_folder

EVERY = 3
"""Of the frames, which are 30 a second."""
UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""The recordings' Y is up."""
TAILS = 5.0
"""Degrees of freedom of the t distribution by which axes are weighed: the few who lie, leap or kneel do not shape the
ellipsoids of all others."""
RESTING = {
    "pelvis": ("trunk", "head", "upper_arm", "forearm", "thigh", "shank"), "spine3": ("head", "upper_arm", "forearm"),
    "shoulder": ("forearm",), "hip": ("shank",),
}  # fmt: skip
"""Parts that hang on an anchor."""


def recorded_poses(data: Path) -> np.ndarray:
    """Return (N, 22, 3, 3) rotations of CMU's takes, the pelvis' world first, Z up."""
    poses = []
    for path in sorted((data / "motion_cmu" / "asfamc").glob("*.npz")):
        rotations = body_rotations(read_clip(path))[::EVERY]
        rotations[:, 1:] = with_shoulder_rhythm(rotations[:, 1:])
        rotations[:, 0] = UP @ rotations[:, 0]
        poses.append(rotations)
    return np.concatenate(poses).astype(np.float64)


def distances(poses: np.ndarray, anchor: str, joint: str) -> np.ndarray:
    """Return (N, 3) of a joint from its place at rest in the anchor's frame, metres, right sides mirrored."""
    body, still = load_body(), (np.zeros(10), poses[:, 0])
    wanted = tuple(part for part in PARTS if part.removeprefix("left_").removeprefix("right_") in RESTING[anchor])
    rested = rest_rotations(body, poses[:, 0], poses[:, 1:], wanted)
    true, rest = (
        forward_kinematics(body, *still, local, np.zeros((len(poses), 3))) for local in (poses[:, 1:], rested)
    )
    sides = ("left_", "right_") if f"left_{joint}" in SMPL_JOINTS else ("",)
    found = []
    for side in sides:
        a = SMPL_JOINTS.index(anchor if anchor in SMPL_JOINTS else side + anchor)
        j = SMPL_JOINTS.index(side + joint)
        away = (true.joints[:, j] - true.joints[:, a]) - (rest.joints[:, j] - rest.joints[:, a])
        found.append(
            (np.swapaxes(true.G[:, a], -1, -2) @ away[..., None])[..., 0] * [-1 if side == "right_" else 1, 1, 1]
        )
    return np.concatenate(found)


def spread(away: np.ndarray) -> np.ndarray:
    """Return the (3,) standard deviations along the axes whose ellipsoids come nearest to what they promise."""
    variance = (away**2).mean(axis=0)
    for _ in range(20):
        weight = (TAILS + 3.0) / (TAILS + (away**2 / variance).sum(axis=-1))
        variance = (weight[:, None] * away**2).mean(axis=0)
    scales = np.linspace(0.3, 4.0, 150)
    tolerance = {"held50": 5.0, "held80": 5.0, "held95": 3.0}
    promised = {"held50": 0.50, "held80": 0.80, "held95": 0.95}

    def miss(scale: float) -> float:
        shares = held(away, scale * variance)
        return sum((100 * (shares[key] - promised[key]) / tolerance[key]) ** 2 for key in HELD)

    return np.sqrt(variance * min(scales, key=miss))


def held(away: np.ndarray, variance: np.ndarray) -> dict[str, float]:
    """Return the shares inside the ellipsoids."""
    squared = (away**2 / variance).sum(axis=-1)
    return {key: float((squared < bound).mean()) for key, bound in HELD.items()}


if __name__ == "__main__":
    recorded = recorded_poses(recordings_folder())
    for anchor, table in SPREAD_MM.items():
        for joint in table:
            away = distances(recorded, anchor, joint)
            sigma = spread(away)
            shares = ", ".join(f"{100 * share:.0f}" for share in held(away, sigma**2).values())
            sys.stdout.write(f"{anchor:<9}{joint:<9}{np.round(1000 * sigma).astype(int)} mm, holds {shares} %\n")
