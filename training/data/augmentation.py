"""Poses the corpus lacks: mirrored, limbs exchanged between poses, joints varied or moved near their limits."""

from __future__ import annotations

import math

import torch

from solver_backend.body.joint_limits import JOINT_LIMITS, excess_deg, from_swing_and_twist, swing_and_twist
from solver_backend.body.rest_skeleton import BODY_MIRROR
from solver_backend.exchange.body_layout import SMPL
from solver_backend.exchange.joint_sets import NUM_BODY_JOINTS
from solver_backend.geometry.rotations import exp_so3

_MIRRORED = torch.tensor(BODY_MIRROR)
_FLIP = torch.tensor([[1.0, -1.0, -1.0], [-1.0, 1.0, 1.0], [-1.0, 1.0, 1.0]])
EXCHANGED_JOINTS: tuple[tuple[int, ...], ...] = (
    SMPL.group("left_arm"),
    SMPL.group("right_arm"),
    SMPL.both("hip", "knee", "ankle", "foot"),
    SMPL.group("left_leg"),
    SMPL.group("right_leg"),
    SMPL.numbers("neck", "head"),
    SMPL.numbers("spine1", "spine2", "spine3"),
)
"""Joints that travel together: left arm, right arm, both legs, left leg, right leg, head, spine."""
EXCHANGE_CHANCE = (0.25, 0.25, 0.3, 0.15, 0.15, 0.3, 0.15)
CLEARANCE_M = 0.07
"""Arm joints of an exchanged pose closer than this to trunk or legs are taken for penetration."""
LIMIT_SHARE = (0.6, 1.0)
"""How much of a joint's range a joint is moved to."""
MOVED_JOINTS = 2
"""Joints of a window that are moved towards their limits."""
_ALLOWED_DEG = 10.0
"""Degrees beyond a joint's limits that a pose may be; chosen by hand."""
_REACH = torch.as_tensor(JOINT_LIMITS).abs().amax(dim=(-1, -2), keepdim=False)
"""Largest angle of each joint, radians."""
_COLLARS, _WRISTS = SMPL.both("collar"), SMPL.both("wrist")
_MIDLINE = SMPL.numbers("spine1", "spine2", "spine3", "neck", "head")
_ARM_POINTS = SMPL.both("elbow", "wrist", "hand")
"""SMPL's elbows, wrists and hands."""
_BODY_BONES = tuple(
    SMPL.numbers(*ends)
    for ends in (
        ("pelvis", "spine2"), ("spine2", "neck"), ("left_hip", "left_knee"), ("right_hip", "right_knee"),
        ("left_knee", "left_ankle"), ("right_knee", "right_ankle"), ("neck", "head"),
    )
)  # fmt: skip
"""Pairs of SMPL's joints that are bones of trunk, head and legs."""


def middle_frame(windows: torch.Tensor) -> int:
    """Return which frame of (B, K, ...) windows is their middle key: the second of four, the only one of one."""
    return (windows.shape[1] - 1) // 2


def mirrored(rotations: torch.Tensor) -> torch.Tensor:
    """Return (..., 21, 3, 3) poses reflected left to right, ``R' = S R S`` with ``S = diag(-1, 1, 1)``."""
    return rotations[..., _MIRRORED, :, :] * _FLIP.to(rotations)


def maybe_mirrored(windows: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
    """Mirror half of the (B, K, 21, 3, 3) windows."""
    chosen = torch.rand(len(windows), 1, 1, 1, 1, generator=generator) < 0.5
    return torch.where(chosen, mirrored(windows), windows)


def exchanged_limbs(windows: torch.Tensor, generator: torch.Generator, chance: float) -> torch.Tensor:
    """Give a share of the (B, K, 21, 3, 3) windows limbs of other windows, of the other side's where mirrored."""
    count = len(windows)
    any_chance = torch.rand(count, generator=generator) < chance
    out, windows = windows.clone(), maybe_mirrored(windows, generator)
    for limb, likely in zip(EXCHANGED_JOINTS, EXCHANGE_CHANCE, strict=True):
        donor = torch.randperm(count, generator=generator)
        take = (torch.rand(count, generator=generator) < likely) & any_chance
        columns = torch.tensor([j - 1 for j in limb])
        taken = torch.where(take[:, None, None, None, None], windows[donor][:, :, columns], out[:, :, columns])
        out[:, :, columns] = taken
    return out


def varied_joints(windows: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
    """Turn collars (5 degrees), wrists (12), neck, head and spine (3) and all others (1.5) by one draw a window."""
    sigma = torch.full((NUM_BODY_JOINTS, 1), math.radians(1.5))
    for joints, degrees in (_COLLARS, 5.0), (_WRISTS, 12.0), (_MIDLINE, 3.0):
        sigma[[joint - 1 for joint in joints]] = math.radians(degrees)
    strength = torch.rand(len(windows), 1, 1, generator=generator) * 1.4
    turn = exp_so3(torch.randn(len(windows), NUM_BODY_JOINTS, 3, generator=generator) * sigma * strength)
    return torch.matmul(windows, turn[:, None])


def near_limits(windows: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
    """Move two joints of every (B, K, 21, 3, 3) window towards the end of one of their ranges.

    One of the joint's three angles (swing across the bone or twist about it) gets 60 to 100 % of its range on either
    side in the window's middle frame; what moves in the window goes on moving.
    """
    count, frames = windows.shape[:2]
    if count == 0:
        return windows
    joint = torch.stack([torch.randperm(NUM_BODY_JOINTS, generator=generator)[:MOVED_JOINTS] for _ in range(count)])
    angle = torch.randint(3, (count, MOVED_JOINTS), generator=generator)
    side = torch.randint(2, (count, MOVED_JOINTS), generator=generator)
    low, high = LIMIT_SHARE
    share = low + (high - low) * torch.rand(count, MOVED_JOINTS, generator=generator)
    target = share * torch.as_tensor(JOINT_LIMITS)[joint, angle, side].to(share.dtype)
    angles = swing_and_twist(windows.flatten(0, 1)).unflatten(0, (count, frames))
    row = torch.arange(count)[:, None]
    moving = angles[row, :, joint, angle]
    angles[row, :, joint, angle] = moving + (target - moving[..., middle_frame(windows)])[..., None]
    moved = from_swing_and_twist(within_reach(angles).flatten(0, 1))
    out = windows.clone()
    out[row, :, joint] = moved.unflatten(0, (count, frames))[row, :, joint]
    return out


def within_reach(angles: torch.Tensor) -> torch.Tensor:
    """Return (..., 21, 3) angles, shortened where all three together go beyond the joint's farthest single limit."""
    length, reach = torch.linalg.vector_norm(angles, dim=-1), _REACH.to(angles.dtype)
    return angles * (reach / torch.maximum(length, reach))[..., None]


def beyond_reach(poses: torch.Tensor) -> torch.Tensor:
    """Return (N,) whether a joint of (N, 21, 3, 3) poses is 10 degrees beyond its range."""
    return (excess_deg(poses) > _ALLOWED_DEG).any(dim=1)


def penetrating(joints: torch.Tensor) -> torch.Tensor:
    """Return (N,) whether an elbow, wrist or hand of (N, 24, 3) joints lies inside trunk, head or legs."""
    points = joints[:, list(_ARM_POINTS)]
    inside = torch.zeros(len(joints), dtype=torch.bool)
    for a, b in _BODY_BONES:
        start, bone = joints[:, None, a], joints[:, None, b] - joints[:, None, a]
        share = ((points - start) * bone).sum(-1, keepdim=True) / (bone * bone).sum(-1, keepdim=True)
        distance = torch.linalg.vector_norm(points - start - share.clamp(0.0, 1.0) * bone, dim=-1)
        inside |= (distance < CLEARANCE_M).any(dim=1)
    return inside
