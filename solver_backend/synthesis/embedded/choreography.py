"""A motion authored in numbers: squats, reaches, steps and a turn, with feet that stand where they stand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.geometry.rotations import exp_so3, log_so3
from solver_backend.types import NUM_BODY_JOINTS, SMPL_JOINTS

Pose = dict[str, tuple[float, float, float]]

_STAND: Pose = {
    "left_shoulder": (0.05, 0.1, -1.25), "right_shoulder": (0.05, -0.1, 1.25),
    "left_elbow": (0, -0.25, 0), "right_elbow": (0, 0.25, 0),
    "left_hip": (-0.05, 0.08, 0.05), "right_hip": (-0.05, -0.08, -0.05),
    "left_knee": (0.1, 0, 0), "right_knee": (0.1, 0, 0), "left_ankle": (-0.05, 0, 0), "right_ankle": (-0.05, 0, 0),
}  # fmt: skip
_SQUAT: Pose = {
    **_STAND,
    "left_hip": (-1.45, 0.25, 0.2), "right_hip": (-1.45, -0.25, -0.2), "left_knee": (1.75, 0, 0),
    "right_knee": (1.75, 0, 0), "left_ankle": (-0.3, 0, 0), "right_ankle": (-0.3, 0, 0),
    "spine1": (0.2, 0, 0), "spine2": (0.12, 0, 0), "neck": (-0.15, 0, 0),
    "left_shoulder": (0, -1.2, -0.25), "right_shoulder": (0, 1.2, 0.25),
    "left_elbow": (0, -0.15, 0), "right_elbow": (0, 0.15, 0),
}  # fmt: skip
_REACH_UP: Pose = {
    **_STAND,
    "right_shoulder": (0, 0.3, -1.05), "right_collar": (0, 0, -0.25), "right_elbow": (0, 0.15, 0),
    "spine2": (0, 0, 0.12), "spine3": (0, 0.1, 0.1), "head": (-0.25, -0.2, 0),
}  # fmt: skip
_REACH_ACROSS: Pose = {
    **_STAND,
    "left_shoulder": (0.1, -1.5, -0.35), "left_elbow": (0, -0.35, 0), "spine1": (0.12, -0.15, 0),
    "spine2": (0.1, -0.25, 0), "spine3": (0.05, -0.2, 0), "head": (0.1, -0.25, 0), "left_wrist": (0, 0, 0.2),
}  # fmt: skip
_STEP_LEFT: Pose = {
    **_STAND,
    "left_hip": (-0.45, 0.05, 0.03), "left_knee": (0.15, 0, 0), "left_ankle": (0.1, 0, 0),
    "right_hip": (0.3, -0.05, -0.03), "right_knee": (0.3, 0, 0), "right_ankle": (0.1, 0, 0),
    "left_shoulder": (0.05, 0.45, -1.2), "right_shoulder": (0.05, 0.45, 1.2), "spine3": (0, -0.1, 0),
    "left_elbow": (0, -0.4, 0), "right_elbow": (0, 0.6, 0),
}  # fmt: skip
_SWING_RIGHT: Pose = {
    **_STAND,
    "left_hip": (-0.02, 0.05, 0.05), "left_knee": (0.12, 0, 0), "left_ankle": (-0.08, 0, 0),
    "right_hip": (-0.35, -0.05, -0.03), "right_knee": (0.95, 0, 0), "right_ankle": (-0.05, 0, 0),
    "left_elbow": (0, -0.4, 0), "right_elbow": (0, 0.4, 0),
}  # fmt: skip


def mirrored(pose: Pose) -> Pose:
    """Return the pose seen in a mirror: sides exchanged, rotations about y and z reversed."""
    other = {"left": "right", "right": "left"}
    result: Pose = {}
    for joint, (x, y, z) in pose.items():
        side, _, part = joint.partition("_")
        result[f"{other[side]}_{part}" if side in other else joint] = (x, -y, -z)
    return result


_SCORE: tuple[tuple[float, Pose, float, str], ...] = (
    (0.00, _STAND, 0.0, "left"), (0.30, _STAND, 0.0, "left"), (0.95, _SQUAT, 0.0, "left"),
    (1.15, _SQUAT, 0.0, "left"), (1.70, _STAND, 0.0, "left"), (2.20, _REACH_UP, 0.0, "left"),
    (2.45, _REACH_UP, 0.0, "left"), (2.95, _REACH_ACROSS, 0.0, "left"), (3.15, _REACH_ACROSS, 0.0, "left"),
    (3.55, mirrored(_SWING_RIGHT), 0.0, "right"), (3.80, _STEP_LEFT, 0.0, "left"),
    (4.10, _SWING_RIGHT, 0.1, "left"), (4.35, mirrored(_STEP_LEFT), 0.2, "right"),
    (4.65, mirrored(_SWING_RIGHT), 0.7, "right"), (4.90, _STEP_LEFT, 1.1, "left"),
    (5.20, _SWING_RIGHT, 1.5, "left"), (5.50, _STAND, 1.8, "right"), (5.75, _SQUAT, 1.8, "right"),
    (6.00, _STAND, 1.8, "right"),
)  # fmt: skip
"""Time in s, pose, heading in rad, and the foot that stands from then on."""


COLLAR_SHARE = 0.2  # Share of an arm's elevation that the collar bone takes.


@dataclass(frozen=True)
class Choreography:
    """SMPL-type parameters of an authored motion, world Z up, floor at z = 0."""

    global_orient: np.ndarray  # (F, 3) axis-angle.
    body_pose: np.ndarray  # (F, 21, 3) axis-angle.
    transl: np.ndarray  # (F, 3) metres.


def author_motion(body: Body, betas: np.ndarray, num_frames: int, fps: float, blend_s: float = 0.09) -> Choreography:
    """Play the score: key poses blended by a Gaussian of ``blend_s``, the standing foot pinned to the floor.

    Args:
        body: the body that moves.
        betas: (10,) its shape.
        num_frames: F; the score lasts six seconds and then holds.
        fps: frames per second.
        blend_s: standard deviation of the blend; makes all curves smooth.
    """
    fine = np.arange(-1.0, num_frames / fps + 1.0, 1 / 240)
    times = np.array([t for t, *_ in _SCORE])
    poses = np.stack([_rotvecs(p) for _, p, _, _ in _SCORE]).reshape(len(times), -1)
    tracks = np.concatenate([poses, np.array([[h] for _, _, h, _ in _SCORE])], axis=1)
    curves = np.stack([np.interp(fine, times, track) for track in tracks.T], axis=1)
    kernel = np.exp(-0.5 * (np.arange(-120, 121) / 240 / blend_s) ** 2)
    curves = np.stack(
        [np.convolve(np.pad(c, 120, mode="edge"), kernel / kernel.sum(), mode="valid") for c in curves.T], 1
    )
    at = np.arange(num_frames) / fps
    sampled = np.stack([np.interp(at, fine, c) for c in curves.T], axis=1)
    body_pose, heading = sampled[:, :-1].reshape(num_frames, NUM_BODY_JOINTS, 3), sampled[:, -1]
    upright = exp_so3(np.array([np.pi / 2, 0.0, 0.0]))
    turn = exp_so3(np.stack([0 * heading, 0 * heading, heading], axis=1))
    root = turn @ upright
    stance = [_SCORE[int(np.searchsorted(times, t, side="right")) - 1][3] for t in at]
    transl = _planted(body, betas, root, exp_so3(body_pose), stance)
    return Choreography(log_so3(root), body_pose, transl)


def _rotvecs(pose: Pose) -> np.ndarray:
    vectors = np.zeros((NUM_BODY_JOINTS, 3))
    for joint, vector in pose.items():
        vectors[SMPL_JOINTS.index(joint) - 1] += vector
    for side in ("left", "right"):
        shoulder, collar = (SMPL_JOINTS.index(f"{side}_{part}") - 1 for part in ("shoulder", "collar"))
        vectors[collar, 2] += COLLAR_SHARE * vectors[shoulder, 2]
        vectors[shoulder, 2] *= 1 - COLLAR_SHARE
    return vectors


def _planted(body: Body, betas: np.ndarray, root: np.ndarray, local: np.ndarray, stance: list[str]) -> np.ndarray:
    """Return translations that keep the standing foot's ball in place and the lowest sole point on the floor."""
    still = forward_kinematics(body, betas, root, local, np.zeros((len(root), 3)))
    balls = {side: still.joints[:, SMPL_JOINTS.index(f"{side}_foot")] for side in ("left", "right")}
    transl = np.zeros((len(root), 3))
    for f in range(1, len(root)):
        ball = balls[stance[f]]
        transl[f, :2] = transl[f - 1, :2] + ball[f - 1, :2] - ball[f, :2]
    transl[:, 2] = -_lowest(body, betas, still.G, still.joints)
    return transl


def _lowest(body: Body, betas: np.ndarray, G: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """Return (F,) the height of the lowest point of both soles, smoothed over the change of feet."""
    rest = body.rest_joints(betas)
    lowest = (body.v_template[:, 1] + body.shapedirs[:, 1] @ betas).min()
    sole_depth = rest[SMPL_JOINTS.index("left_foot"), 1] - lowest
    heights = []
    for side in ("left", "right"):
        ankle, foot = SMPL_JOINTS.index(f"{side}_ankle"), SMPL_JOINTS.index(f"{side}_foot")
        ball = joints[:, foot] + G[:, foot] @ np.array([0.0, -sole_depth, 0.0])
        back = np.array([0.0, rest[foot, 1] - rest[ankle, 1] - sole_depth, -0.04])
        heel = joints[:, ankle] + G[:, ankle] @ back
        toe = joints[:, foot] + G[:, foot] @ np.array([0.0, -sole_depth, 0.065])
        heights += [ball[:, 2], heel[:, 2], toe[:, 2]]
    stacked = np.stack(heights)
    sharpness = 300.0
    return -np.log(np.exp(-sharpness * (stacked - stacked.min(axis=0))).sum(axis=0)) / sharpness + stacked.min(axis=0)
