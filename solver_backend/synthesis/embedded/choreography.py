"""A motion authored in numbers: squats, reaches, steps and a turn, with standing feet that do not slide."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.geometry.rotations import exp_so3, log_so3
from solver_backend.types import NUM_BODY_JOINTS, SMPL_JOINTS

_FILE = Path(__file__).parents[2] / "assets" / "choreography.json"
_COLLAR_SHARE = 0.2  # Share of an arm's elevation that the collar bone takes.
_STEPS_PER_S = 240  # Samples per second of the blended score.
_SHARPNESS = 300.0  # Of the smooth minimum over sole points, 1/m.


class Choreography(NamedTuple):
    """SMPL-type parameters of an authored motion, world Z up, floor at z = 0."""

    global_orient: np.ndarray  # (F, 3) axis-angle.
    body_pose: np.ndarray  # (F, 21, 3) axis-angle.
    transl: np.ndarray  # (F, 3) metres.


@cache
def _score() -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Return times (n,) in s, tracks (n, 64) of key poses and heading, and the foot that stands from each time on."""
    values = json.loads(_FILE.read_text(encoding="utf-8"))
    times, names, headings, feet = zip(*values["score"], strict=True)
    poses = [_rotvecs(values["poses"]["stand"] | values["poses"][name]).ravel() for name in names]
    return np.array(times), np.column_stack([np.stack(poses), headings]), list(feet)


def author_motion(body: Body, betas: np.ndarray, num_frames: int, fps: float) -> Choreography:
    """Play the score: key poses blended by a Gaussian, the standing foot pinned to the floor.

    Args:
        betas: (10,) shape.
        num_frames: F; the score lasts six seconds and then holds.
        fps: frames per second.
    """
    times, tracks, feet = _score()
    fine = np.arange(-1.0, num_frames / fps + 1.0, 1 / _STEPS_PER_S)
    curves = [np.interp(fine, times, track) for track in tracks.T]
    kernel = np.exp(-0.5 * (np.arange(-120, 121) / _STEPS_PER_S / 0.09) ** 2)
    curves = [np.convolve(np.pad(c, 120, mode="edge"), kernel / kernel.sum(), mode="valid") for c in curves]
    at = np.arange(num_frames) / fps
    sampled = np.stack([np.interp(at, fine, c) for c in curves], axis=1)
    body_pose, heading = sampled[:, :-1].reshape(num_frames, NUM_BODY_JOINTS, 3), sampled[:, -1]
    turn = exp_so3(np.stack([0 * heading, 0 * heading, heading], axis=1))
    root = turn @ exp_so3(np.array([np.pi / 2, 0.0, 0.0]))
    stance = [feet[int(np.searchsorted(times, t, side="right")) - 1] for t in at]
    return Choreography(log_so3(root), body_pose, _planted(body, betas, root, exp_so3(body_pose), stance))


def _rotvecs(pose: dict[str, list[float]]) -> np.ndarray:
    vectors = np.zeros((NUM_BODY_JOINTS, 3))
    for joint, vector in pose.items():
        vectors[SMPL_JOINTS.index(joint) - 1] = vector
    for side in ("left", "right"):
        shoulder, collar = (SMPL_JOINTS.index(f"{side}_{part}") - 1 for part in ("shoulder", "collar"))
        vectors[collar, 2] += _COLLAR_SHARE * vectors[shoulder, 2]
        vectors[shoulder, 2] *= 1 - _COLLAR_SHARE
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
        back = [0.0, rest[foot, 1] - rest[ankle, 1] - sole_depth, -0.04]
        points = ((foot, [0.0, -sole_depth, 0.0]), (ankle, back), (foot, [0.0, -sole_depth, 0.065]))
        heights += [(joints[:, joint] + G[:, joint] @ np.array(offset))[:, 2] for joint, offset in points]
    stacked = np.stack(heights)
    low = stacked.min(axis=0)
    return -np.log(np.exp(-_SHARPNESS * (stacked - low)).sum(axis=0)) / _SHARPNESS + low
