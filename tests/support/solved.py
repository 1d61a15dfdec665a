"""A capture and a solve of it with known faults: a gap, a camera that is off, a keypoint nobody sees."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from solver_backend.exchange.diagnostics import Severity, diagnostic
from solver_backend.types import FLAG_UNSEEN, FLAG_UNSURE, SMPL_JOINTS, Capture, JointSet, Keypoints2D, Motion
from tests.support.scenes import ring_of_cameras, walker

FRAMES, FPS = 90, 30.0
GAP = (40, 54)
OFF = (70, 75)
NAME = 'Take <b>1</b> & "more"'
_REST = {
    "spine1": (0, 0, 1.05), "spine2": (0, 0, 1.15), "spine3": (0, 0, 1.25), "left_foot": (0.11, 0.12, 0.03),
    "right_foot": (-0.11, 0.12, 0.03), "neck": (0, 0, 1.48), "left_collar": (0.08, 0, 1.42),
    "right_collar": (-0.08, 0, 1.42), "head": (0, 0.03, 1.6), "left_hand": (0.31, 0.14, 0.85),
    "right_hand": (-0.31, 0.14, 0.85), "pelvis": (0, 0, 0.95),
}  # fmt: skip


def joints_of(points: np.ndarray, joint_set: JointSet) -> np.ndarray:
    """Return (F, 24, 3) joints that go along with keypoints (F, K, 3)."""
    hips = points[:, [joint_set.keypoints.index("left_hip"), joint_set.keypoints.index("right_hip")]].mean(axis=1)
    joints = np.empty((len(points), len(SMPL_JOINTS), 3))
    for j, name in enumerate(SMPL_JOINTS):
        if name in joint_set.keypoints:
            joints[:, j] = points[:, joint_set.keypoints.index(name)]
        else:
            joints[:, j] = _REST[name]
            joints[:, j, :2] += hips[:, :2]
    return joints


def solved(faults: bool = True, truth: bool = False, views: int = 4) -> tuple[Capture, Motion]:
    """Return a capture and its solve; without faults every detection is 2 px off."""
    cameras, joint_set = ring_of_cameras(views, distortion=0.0), JointSet.COCO_17
    points = walker(joint_set, FRAMES, (0.0, -0.5), (0.0, 0.3))
    rng = np.random.default_rng(0)
    angle = rng.uniform(0, 2 * np.pi, (views, FRAMES, joint_set.num_keypoints))
    error = np.full(angle.shape, 2.0)
    confidence = np.ones(angle.shape)
    flags = np.zeros(FRAMES, np.uint8)
    if faults:
        confidence[1:, GAP[0] : GAP[1] + 1] = 0.0
        confidence[:3, :, 0] = 0.0
        error[2] = 9.0
        error[0, ::3, 5] = 400.0
        flags[GAP[0] : GAP[1] + 1] |= FLAG_UNSEEN
        flags[OFF[0] : OFF[1] + 1] |= FLAG_UNSURE
    xy = 500.0 + error[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    keypoints = Keypoints2D(xy, confidence, joint_set, FPS)
    joints = joints_of(points, joint_set)
    known = {"joints": joints + [0.003, 0.004, 0.0], "keypoints3d": points} if truth else {}
    capture = Capture(
        NAME,
        cameras,
        keypoints,
        sources=("one.json",),
        notes=(diagnostic("scene_message", severity=Severity.NOTE, text="Read as metres."),),
        truth=known,
    )
    motion = Motion(
        betas=np.zeros(10), global_orient=np.zeros((FRAMES, 3)), body_pose=np.zeros((FRAMES, 69)),
        transl=np.zeros((FRAMES, 3)), fps=FPS, body="neutral-1", joints=joints, keypoints3d=points,
        joint_set=joint_set, keyframes=np.arange(FRAMES) % 10 == 0, flags=flags,
        reprojection_px=np.where(confidence > 0, error, np.nan).astype(np.float32),
        provenance={
            "solver": "0.1.0", "solve_s": 4.5, "sigma_px": [2.0] * 17,
            "settings": {"method": "global", "robust_scale": 3.0}, "worst": float("nan"),
        },
    )  # fmt: skip
    return capture, motion


def bare(capture: Capture, motion: Motion) -> tuple[Capture, Motion]:
    """Return them without anything that is optional."""
    without = dict.fromkeys(("keypoints3d", "joint_set", "joint_sigma", "keyframes", "flags", "reprojection_px"))
    return replace(capture, cameras=None, keypoints=None), replace(motion, **without, provenance={})
