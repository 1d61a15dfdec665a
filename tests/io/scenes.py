"""Small synthetic captures and motions for the tests of reading and writing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.types import Cameras, Capture, JointSet, Keypoints2D, MarkerCloud, Motion

NAMES = ("cam_a", "cam_b", "cam_c", "cam_d")


def look_at(centre: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Return the rotation world (Z up) to camera (x right, y down, z forward) that looks at a point."""
    forward = (target - centre) / np.linalg.norm(target - centre)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward])


def ring_of_cameras(count: int = 4, radius: float = 4.0, height: float = 1.6, distortion: float = -0.05) -> Cameras:
    """Return cameras on a circle that look at the middle of a person."""
    angles = 2 * np.pi * np.arange(count) / count + 0.3
    centres = np.stack([radius * np.cos(angles), radius * np.sin(angles), np.full(count, height)], axis=1)
    R = np.stack([look_at(c, np.array([0.0, 0.0, 0.9])) for c in centres])
    K = np.tile(np.array([[1400.0, 0, 959.5], [0, 1410.0, 539.5], [0, 0, 1]]), (count, 1, 1))
    coefficients = np.tile([distortion, 0.02, 0.0005, -0.0003, 0.0], (count, 1))
    names = tuple(f"cam_{'abcdefghij'[i]}" for i in range(count))
    return Cameras(names, K, coefficients, R, -np.einsum("cij,cj->ci", R, centres), np.tile([1920, 1080], (count, 1)))


def small_capture(frames: int = 7, joint_set: JointSet = JointSet.COCO_17, views: int = 4, seed: int = 0) -> Capture:
    """Return a capture of random numbers with every optional part filled."""
    rng = np.random.default_rng(seed)
    count = joint_set.num_keypoints
    xy = rng.uniform(0, 1000, (views, frames, count, 2)).astype(np.float32)
    confidence = rng.uniform(0.1, 1.0, (views, frames, count)).astype(np.float32)
    xy[0, 0, 0] = np.nan
    confidence[-1, -1, -1] = 0.0
    return Capture(
        name="Übung 1",
        cameras=ring_of_cameras(views),
        keypoints=Keypoints2D(xy, confidence, joint_set, 59.94),
        footage=tuple(None if i == 1 else Path(f"video_{i}.mp4") for i in range(views)),
        sources=("a.json", "b.toml"),
        notes=("Read as metres.",),
        problems=("One camera is dark.", "Ünicode."),
        truth={"joints": rng.normal(size=(frames, 24, 3)), "betas": rng.normal(size=10)},
    )


def small_markers(frames: int = 5) -> MarkerCloud:
    """Return a labelled marker cloud with a gap."""
    positions = np.random.default_rng(1).normal(size=(frames, 3, 3)).astype(np.float32)
    positions[0, 1] = np.nan
    return MarkerCloud(positions, 120.0, labels=("LASI", "RASI", "C7"), residual=np.full((frames, 3), 0.5, np.float32))


def small_motion(frames: int = 6, optional: bool = True, seed: int = 0) -> Motion:
    """Return a motion of random numbers, with or without its optional parts."""
    rng = np.random.default_rng(seed)
    keypoints3d = rng.normal(size=(frames, 17, 3)).astype(np.float32)
    keypoints3d[0, 3] = np.nan
    reprojection = rng.uniform(0, 9, (4, frames, 17)).astype(np.float32)
    reprojection[1, 0] = np.nan
    extra: dict[str, Any] = {
        "keypoints3d": keypoints3d,
        "joint_set": JointSet.COCO_17,
        "joint_sigma": rng.uniform(0.01, 0.1, (frames, 24)).astype(np.float32),
        "keyframes": rng.uniform(size=frames) > 0.5,
        "contacts": rng.uniform(size=(frames, 2)) > 0.5,
        "flags": rng.integers(0, 4, frames).astype(np.uint8),
        "reprojection_px": reprojection,
    }
    return Motion(
        betas=rng.normal(size=10).astype(np.float32),
        global_orient=rng.normal(size=(frames, 3)).astype(np.float32),
        body_pose=rng.normal(size=(frames, 69)).astype(np.float32),
        transl=rng.normal(size=(frames, 3)).astype(np.float32),
        fps=59.94,
        body="neutral-1",
        joints=rng.normal(size=(frames, 24, 3)).astype(np.float32),
        provenance={"version": "0.1", "settings": {"window": 20}, "mean": np.float32(1.5), "worst": float("nan")},
        **(extra if optional else {}),
    )
