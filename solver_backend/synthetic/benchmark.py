"""Benchmark captures: recorded motion on our body, seen by tripod cameras and a detector that errs like a real one."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from solver_backend.body.body import Body, load_body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.body.landmarks import pose_landmarks
from solver_backend.cameras.projection import project
from solver_backend.errors import TakeTooShort
from solver_backend.geometry.rotations import exp_so3, log_so3
from solver_backend.synthetic.demo import tripods
from solver_backend.synthetic.keypoint_detector import DetectorModel, detect_keypoints
from solver_backend.synthetic.occlusion import self_occluded
from solver_backend.types import NUM_BETAS, NUM_JOINTS, SMPL_JOINTS, Cameras, Capture, JointSet, Keypoints2D

ANATOMY_BIAS_M = 0.008
"""Standard deviation per axis of what a detector means by a joint against what the body means: measured as the median
13 mm that a solve of Pose2Sim's balancing trial assigns to its landmarks."""
BETAS_SIGMA = 0.8
"""Spread of the drawn shapes, within the range of most people."""
LENS = (-0.047, 0.137, 0.0003, 0.0002, 0.0, 0.0, 0.0, 0.0)
"""Distortion like that of the recording's cameras."""
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
class BenchmarkSettings:
    """How a take is filmed."""

    num_views: int = 4
    """Cameras."""
    seed: int = 0
    """Of shape, bias and noise."""
    sync_offset_frames: float = 0.0
    """Largest delay of a camera; each but the first draws its own, uniformly in ±."""
    detector: DetectorModel = field(default_factory=DetectorModel)
    """The detector."""


def benchmark_capture(take: Take, settings: BenchmarkSettings = BenchmarkSettings()) -> Capture:
    """Film a take; the truth goes along (SMPL parameters, joints, keypoints, exchanges, delays).

    Raises:
        TakeTooShort: fewer than four frames.
    """
    if len(take.rotations) < 4:
        raise TakeTooShort(f"A benchmark take needs 4 frames, this one has {len(take.rotations)}.", where=take.name)
    rng = np.random.default_rng(settings.seed)
    body, joint_set = load_body(), JointSet.BODY_25
    betas = np.clip(BETAS_SIGMA * rng.normal(size=NUM_BETAS), -2.0, 2.0)
    landmarks = keypoint_landmarks(body, joint_set)
    orient, transl = _on_the_floor(body, betas, take)
    local = take.rotations[:, 1:]
    true = pose_landmarks(body, landmarks, betas, orient, local, transl)
    offsets = ANATOMY_BIAS_M * rng.normal(size=(len(landmarks), 3))
    meant = pose_landmarks(body, landmarks, betas, orient, local, transl, offsets=offsets).points
    cameras = around(true.skeleton.joints[:, 0], settings.num_views)
    px = project(cameras.K, cameras.distortion, cameras.R, cameras.t, meant, cameras.distortion_model)
    hidden = self_occluded(cameras, true.skeleton.joints, meant, joint_set.keypoints)
    delays = np.r_[0.0, rng.uniform(-1, 1, len(cameras) - 1)] * settings.sync_offset_frames
    px = np.stack([delayed(track, delay) for track, delay in zip(px, delays, strict=True)])
    found = detect_keypoints(
        px, _px_per_mm(cameras, meant), hidden, cameras.image_size, joint_set, take.fps, settings.detector, rng
    )
    body_pose = np.zeros((len(local), 3 * (NUM_JOINTS - 1)))
    body_pose[:, :63] = log_so3(local).reshape(len(local), -1)
    truth = {
        "betas": betas, "global_orient": log_so3(orient), "body_pose": body_pose, "transl": transl,
        "joints": true.skeleton.joints, "keypoints3d": true.points, "swapped": found.swapped,
        "outlier": found.outlier, "delay_frames": delays,
    }  # fmt: skip
    return Capture(
        name=f"{take.name}_{settings.num_views}views_seed{settings.seed}",
        cameras=cameras,
        keypoints=Keypoints2D(found.xy, found.confidence, joint_set, take.fps),
        footage=(None,) * len(cameras),
        sources=(take.name,),
        notes=("Synthetic capture: recorded motion, simulated cameras and detector; the truth is known.",),
        truth=truth,
    )


def around(pelvis: np.ndarray, num_views: int) -> Cameras:
    """Return tripod cameras that keep a person on this (F, 3) path in view; two stand at a right angle or so."""
    low, high = pelvis.min(axis=0), pelvis.max(axis=0)
    centre = np.array([*(0.5 * (low + high))[:2], 0.95])
    radius = 4.2 + 0.5 * float(np.linalg.norm((high - low)[:2]))
    ring = tripods(centre, max(num_views, 4), radius)
    cameras = ring if num_views >= 4 else ring.subset([0, 1, 2][:num_views])
    return Cameras(
        cameras.names, cameras.K, np.tile(LENS, (len(cameras), 1)), cameras.R, cameras.t, cameras.image_size,
        cameras.distortion_model,
    )  # fmt: skip


def delayed(track: np.ndarray, frames: float) -> np.ndarray:
    """Return an (F, ...) track as a camera sees it that runs late by some frames (linear between, held at the ends)."""
    at = np.clip(np.arange(len(track)) - frames, 0, len(track) - 1)
    first = np.minimum(np.floor(at).astype(int), len(track) - 2)
    share = (at - first).reshape(-1, *([1] * (track.ndim - 1)))
    return (1 - share) * track[first] + share * track[first + 1]


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


def _px_per_mm(cameras: Cameras, points: np.ndarray) -> np.ndarray:
    depth = np.einsum("cj,fkj->cfk", cameras.R[:, 2], points) + cameras.t[:, 2, None, None]
    return cameras.K[:, 0, 0, None, None] / (1000.0 * np.maximum(depth, 0.1))
