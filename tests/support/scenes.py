"""Small synthetic captures and motions for the tests of reading and writing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from solver_backend.cameras.projection import project
from solver_backend.exchange.diagnostics import Severity, diagnostic
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
    names = tuple(f"cam_{'abcdefghijklmnop'[i]}" for i in range(count))
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
        notes=(diagnostic("scene_message", severity=Severity.NOTE, text="Read as metres."),),
        problems=tuple(diagnostic("scene_message", text=text) for text in ("One camera is dark.", "Ünicode.")),
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
        "joint_covariance": rng.uniform(1e-4, 1e-2, (frames, 24, 6)).astype(np.float32),
        "turn_covariance": rng.uniform(1e-4, 1e-2, (frames, 17, 6)).astype(np.float32),
        "keyframes": rng.uniform(size=frames) > 0.5,
        "contacts": rng.uniform(size=(frames, 2)) > 0.5,
        "flags": rng.integers(0, 4, frames).astype(np.uint8),
        "reprojection_px": reprojection,
        "markers": rng.normal(size=(frames, 3, 3)).astype(np.float32),
        "marker_labels": ("LASI", "RASI", "C7"),
        "marker_residual_mm": rng.uniform(0, 9, (frames, 3)).astype(np.float32),
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


_STANDING = {
    "nose": (0.0, 0.10, 1.62), "left_eye": (-0.03, 0.08, 1.66), "right_eye": (0.03, 0.08, 1.66),
    "left_ear": (-0.07, 0.0, 1.64), "right_ear": (0.07, 0.0, 1.64), "left_shoulder": (-0.19, 0.0, 1.45),
    "right_shoulder": (0.19, 0.0, 1.45), "left_elbow": (-0.27, 0.02, 1.17), "right_elbow": (0.27, 0.02, 1.17),
    "left_wrist": (-0.30, 0.10, 0.93), "right_wrist": (0.30, 0.10, 0.93), "left_hip": (-0.10, 0.0, 0.95),
    "right_hip": (0.10, 0.0, 0.95), "left_knee": (-0.11, 0.03, 0.52), "right_knee": (0.11, 0.03, 0.52),
    "left_ankle": (-0.11, 0.0, 0.09), "right_ankle": (0.11, 0.0, 0.09),
}  # fmt: skip
_BETWEEN = {
    "neck": ("left_shoulder", "right_shoulder"), "mid_hip": ("left_hip", "right_hip"),
    "upper_neck": ("left_shoulder", "right_shoulder"), "thorax": ("left_shoulder", "right_shoulder"),
    "spine": ("neck", "mid_hip"), "head_top": ("nose", "nose"),
}  # fmt: skip
_FOOT = {"heel": (0.0, -0.05, -0.05), "big_toe": (0.0, 0.17, -0.06), "small_toe": (0.05, 0.13, -0.06)}


def walker(
    joint_set: JointSet, frames: int, start: tuple[float, float], velocity: tuple[float, float], *, phase: float = 0.0
) -> np.ndarray:
    """Return (F, K, 3) world metres of a person of 1.75 m who walks over the floor and swings arms and legs."""
    base = {name: np.array(point) for name, point in _STANDING.items()}
    for name, (a, b) in _BETWEEN.items():
        base[name] = (base[a] + base[b]) / 2 if name != "head_top" else np.array([0.0, 0.0, 1.75])
    for side in ("left", "right"):
        for name, offset in _FOOT.items():
            base[f"{side}_{name}"] = base[f"{side}_ankle"] + offset
    time = np.arange(frames) / 30.0
    heading = np.arctan2(-velocity[0], velocity[1]) if any(velocity) else phase
    turn = np.array([[np.cos(heading), -np.sin(heading), 0], [np.sin(heading), np.cos(heading), 0], [0, 0, 1]])
    points = np.empty((frames, joint_set.num_keypoints, 3))
    for k, name in enumerate(joint_set.keypoints):
        point = np.tile(base[name], (frames, 1))
        side = 1.0 if name.startswith("left") else -1.0 if name.startswith("right") else 0.0
        reach = {"wrist": 0.25, "elbow": 0.12, "knee": -0.12}.get(name.split("_")[-1], 0.0)
        reach = -0.25 if any(part in name for part in ("ankle", "heel", "toe")) else reach
        point[:, 1] += side * reach * np.sin(2 * np.pi * time + phase)
        points[:, k] = point @ turn.T
    points[..., :2] += np.array(start) + time[:, None, None] * np.array(velocity)
    return points


def detected(
    cameras: Cameras, points: np.ndarray, rng: np.random.Generator, *, sigma_px: float = 4.0
) -> tuple[np.ndarray, np.ndarray]:
    """Return noisy pixels (C, F, K, 2) and confidences (C, F, K) of world points (F, K, 3)."""
    px = project(cameras, points)
    xy = px + rng.normal(scale=sigma_px, size=px.shape)
    return xy, np.where(np.isfinite(xy).all(-1), rng.uniform(0.4, 0.9, xy.shape[:-1]), 0.0)
