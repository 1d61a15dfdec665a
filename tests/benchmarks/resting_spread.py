"""Deviations of resting joints from the joints of people: ``python -m tests.benchmarks.resting_spread``.

Prints, by anchor and joint, the standard deviations along the anchor bone's axes for ``SPREAD_MM``, and the shares of
joints inside the 50, 80 and 95 % ellipsoids for each group of recordings: CMU's skeletons, and marker takes solved with
all markers. Needs the recordings (MOCAP_SHARED_DATA) and some minutes. ``--held`` evaluates the current table instead.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from solver_backend.body.body import load_body
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.body.resting_posture import PARTS, rest_rotations
from solver_backend.fitters import SolveSettings, solve
from solver_backend.fitters.rest_parts import SPREAD_MM, Stance, growth, stance
from solver_backend.geometry.rotations import exp_so3
from solver_backend.io.markers.read import read_markers
from solver_backend.io.motions.recorded_clip import body_rotations
from solver_backend.types import SMPL_JOINTS, Capture, MarkerCloud
from tests.benchmarks.marker_takes.takes import ui_prmd
from tests.support.recordings import recordings_folder
from training.data.sources.clips import read_clip, with_shoulder_rhythm

EVERY = 9  # Every n-th of CMU's frames is used, which have 30 Hz.
UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # The recordings have Y up.
BOUNDS = np.array([2.366, 4.642, 7.815])  # Squared distances of the 50, 80 and 95 % ellipsoids, in deviations.
PROMISED, TOLERANCE = np.array([0.50, 0.80, 0.95]), np.array([0.05, 0.05, 0.03])
WEIGHTS = {"cmu": 0.45, "ui_prmd": 0.40, "nimble": 0.15}
"""Weight of each group of recordings, independent of its number of frames."""
STEPS, FACTOR = 400, 3.0  # Steps of the search, and limit of a deviation as a factor of the root mean square.
RATE, FRAMES, KEPT = 25.0, 400, 60
"""Frames per second, maximum number of solved frames per take, and approximate number of evaluated frames."""
RESTING = {
    "pelvis": ("trunk", "head", "upper_arm", "forearm", "thigh", "shank"), "spine3": ("head", "upper_arm", "forearm"),
    "shoulder": ("forearm",), "hip": ("shank",),
}  # fmt: skip
"""Body parts that depend on an anchor."""
NIMBLE = (
    "Sprinter/run0350cms", "Sprinter/run0700cms", "Subject4/MarkerData/squats1", "Subject4/MarkerData/STS1",
    "Subject4/MarkerData/walking1", "Subject4/MarkerData/DJ1",
)  # fmt: skip


@dataclass(frozen=True)
class Poses:
    """N poses of several takes."""

    rotations: np.ndarray  # (N, 22, 3, 3) rotations, starting with the pelvis in the world, Z up.
    shown: Stance  # Stance derived from the pelvis.


def joined(takes: list[tuple[np.ndarray, Stance]], every: list[int]) -> Poses:
    """Return every n-th pose of takes, with n for each take."""
    parts = [
        (rotations[::step], shown.lean[::step], shown.walking[::step], shown.low[::step])
        for (rotations, shown), step in zip(takes, every, strict=True)
    ]
    rotations, *shown = (np.concatenate(part).astype(np.float64) for part in zip(*parts, strict=True))
    return Poses(rotations, Stance(*shown))


def recorded_poses(data: Path) -> Poses:
    """Return poses of CMU's takes."""
    takes = []
    for path in sorted((data / "motion_cmu" / "asfamc").glob("*.npz")):
        clip = read_clip(path)
        rotations = body_rotations(clip)
        rotations[:, 1:] = with_shoulder_rhythm(rotations[:, 1:])
        rotations[:, 0] = UP @ rotations[:, 0]
        with np.load(path) as file:
            places = file["root"][-len(rotations) :].astype(np.float64) @ UP.T
        takes.append((rotations, stance(rotations[:, 0], places, clip.fps)))
    return joined(takes, [EVERY] * len(takes))


def solved_poses(takes: Iterator[MarkerCloud]) -> Poses:
    """Return poses of takes that are solved with all their markers."""
    poses = []
    for cloud in takes:
        step = max(1, int(cloud.fps // RATE))
        cloud = replace(cloud, positions=cloud.positions[::step][:FRAMES], residual=None, fps=cloud.fps / step)
        motion = solve(Capture("take", markers=cloud), SolveSettings(contacts=False)).motion
        local = exp_so3(motion.body_pose[:, :63].reshape(-1, 21, 3))
        rotations = np.concatenate([exp_so3(motion.global_orient)[:, None], local], axis=1)
        poses.append((rotations, stance(rotations[:, 0], motion.joints[:, 0], motion.fps)))
    return joined(poses, [max(1, len(rotations) // KEPT) for rotations, _ in poses])


def marker_takes(data: Path) -> dict[str, Iterator[MarkerCloud]]:
    """Return takes by group: two of each UI-PRMD movement by different people, and running laboratories' takes."""
    clips: dict[str, list[Path]] = {}
    for path in sorted((data / "markers" / "ui_prmd").glob("m*_s*_e*.npz")):
        clips.setdefault(path.stem[:3], []).append(path)
    chosen = [paths[(7 * k + 23 * j) % len(paths)] for k, paths in enumerate(clips.values()) for j in (0, 1)]
    nimble = data / "markers" / "nimble"
    return {
        "ui_prmd": (ui_prmd(path) for path in chosen),
        "nimble": (read_markers(nimble / f"{name}.trc").cloud for name in NIMBLE),
    }


def distances(recorded: Poses, anchor: str, joint: str) -> np.ndarray:
    """Return (N, 3) displacements of a joint from its rest position in the anchor's frame, right sides mirrored.

    They are metres divided by ``growth``, so that they correspond to a person who stands upright.
    """
    poses = recorded.rotations
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
        own = (np.swapaxes(true.G[:, a], -1, -2) @ away[..., None])[..., 0] * [-1 if side == "right_" else 1, 1, 1]
        found.append(own / growth(recorded.shown, anchor, joint)[:, None])
    return np.concatenate(found)


def held(away: np.ndarray, weight: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """Return the (3,) shares inside the 50, 80 and 95 % ellipsoids."""
    squared = ((away / sigma) ** 2).sum(axis=-1)
    return np.array([weight @ (squared < bound) for bound in BOUNDS])


def spread(away: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return the (3,) standard deviations with the best shares in their ellipsoids, by random search."""
    rms, rng, step = np.sqrt(weight @ away**2), np.random.default_rng(0), 0.6

    def miss(sigma: np.ndarray) -> float:
        ratio = np.abs(np.log(sigma / rms))
        strange = 0.02 * ratio.sum() + 100.0 * np.maximum(ratio - np.log(FACTOR), 0.0).sum()
        return float((((held(away, weight, sigma) - PROMISED) / TOLERANCE) ** 2).sum() + strange)

    best, least = rms, miss(rms)
    for _ in range(STEPS):
        tried = best * np.exp(step * rng.normal(size=3) * (rng.random(3) < 0.6))
        if (cost := miss(tried)) < least:
            best, least = tried, cost
        step = max(0.03, 0.99 * step)
    return best


if __name__ == "__main__":
    data = recordings_folder()
    poses = {"cmu": recorded_poses(data), **{name: solved_poses(takes) for name, takes in marker_takes(data).items()}}
    total = {name: np.zeros(3) for name in WEIGHTS}
    for anchor, table in SPREAD_MM.items():
        for joint, known in table.items():
            away = {name: distances(poses[name], anchor, joint) for name in WEIGHTS}
            weight = {name: np.full(len(away[name]), 1.0 / len(away[name])) for name in WEIGHTS}
            every = np.concatenate([WEIGHTS[name] * weight[name] for name in WEIGHTS])
            together = np.concatenate([away[name] for name in WEIGHTS])
            sigma = 1e-3 * np.array(known) if "--held" in sys.argv else spread(together, every)
            shares = {name: held(away[name], weight[name], sigma) for name in WEIGHTS}
            total = {name: total[name] + shares[name] for name in WEIGHTS}
            texts = [f"{name} {'/'.join(f'{100 * share:.0f}' for share in shares[name])}" for name in WEIGHTS]
            sys.stdout.write(f"{anchor:<9}{joint:<9}{np.round(1000 * sigma).astype(int)} mm, {', '.join(texts)} %\n")
    count = sum(map(len, SPREAD_MM.values()))
    for name, shares in total.items():
        sys.stdout.write(f"{name}: {'/'.join(f'{100 * share / count:.0f}' for share in shares)} %\n")
