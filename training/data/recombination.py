"""Limbs turned anywhere within anatomical limits, and their ends to the very end: joints that no recording joins."""

from __future__ import annotations

import torch

from solver_backend.body.joint_limits import JOINT_LIMITS, from_swing_and_twist, swing_and_twist
from solver_backend.exchange.body_layout import SMPL
from solver_backend.exchange.joint_sets import NUM_BODY_JOINTS
from training.data.augmentation import middle_frame, within_reach

LIMBS: tuple[tuple[int, ...], ...] = (
    *map(SMPL.group, ("left_leg", "right_leg", "left_arm", "right_arm")),
    SMPL.numbers("spine1", "spine2", "spine3"), SMPL.numbers("neck", "head"),
)  # fmt: skip
"""Joints that are turned together: legs, arms, spine, neck and head."""
LIMB_CHANCE = 0.4
"""Of each limb of a window to be turned; at least one is."""
LIMB_SPREAD = (0.05, 0.3)
"""Standard deviation of a turned joint's angles as a share of their ranges: least and greatest, one draw a window."""
ENDS: tuple[int, ...] = SMPL.both("ankle", "foot", "wrist")
"""Ankles, toes and wrists, which recordings hold short of how far they reach."""
END_CHANCE = 0.5
"""Of each end of a window to be moved."""
_LIMITS = torch.as_tensor(JOINT_LIMITS, dtype=torch.float32)


def limbs_turned(windows: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
    """Turn limbs of (B, K, 21, 3, 3) windows within their joints' limits, by one draw of angles a window.

    To each of a joint's three angles (swing across the bone and twist about it) comes a normal draw of ``LIMB_SPREAD``
    of its range; what leaves the range stops at its end. What moves in the window goes on moving.
    """
    count = len(windows)
    chosen = torch.rand(count, len(LIMBS), generator=generator) < LIMB_CHANCE
    chosen[torch.arange(count), torch.randint(len(LIMBS), (count,), generator=generator)] = True
    joints = torch.zeros(count, NUM_BODY_JOINTS, dtype=torch.bool)
    for number, limb in enumerate(LIMBS):
        joints[:, [j - 1 for j in limb]] = chosen[:, number, None]
    low, high = LIMB_SPREAD
    spread = low + (high - low) * torch.rand(count, 1, 1, generator=generator)
    turn = spread * (_LIMITS[..., 1] - _LIMITS[..., 0]) * torch.randn(count, NUM_BODY_JOINTS, 3, generator=generator)
    return _moved(windows, turn, joints)


def ends_reaching(windows: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
    """Move ankles, toes and wrists of (B, K, 21, 3, 3) windows to anywhere between where they are and an end.

    One of the joint's three angles moves, to either side; in the window's middle frame it comes as far as drawn.
    """
    count, ends = len(windows), torch.tensor(ENDS) - 1
    joints = torch.zeros(count, NUM_BODY_JOINTS, dtype=torch.bool)
    joints[:, ends] = torch.rand(count, len(ENDS), generator=generator) < END_CHANCE
    angle = torch.randint(3, (count, len(ENDS)), generator=generator)
    side = torch.randint(2, (count, len(ENDS)), generator=generator)
    share = torch.rand(count, len(ENDS), generator=generator)
    here = swing_and_twist(windows[:, middle_frame(windows)])[:, ends].gather(2, angle[..., None])[..., 0]
    turn = torch.zeros(count, NUM_BODY_JOINTS, 3)
    row = torch.arange(count)[:, None]
    turn[row, ends, angle] = share * (_LIMITS[ends, angle, side] - here)
    return _moved(windows, turn, joints)


def _moved(windows: torch.Tensor, turn: torch.Tensor, joints: torch.Tensor) -> torch.Tensor:
    """Return windows whose chosen (B, 21) joints' angles are ``turn`` (B, 21, 3) rad further, but within limits."""
    count, frames = windows.shape[:2]
    angles = swing_and_twist(windows.flatten(0, 1)).unflatten(0, (count, frames)) + turn[:, None]
    angles = within_reach(angles.clamp(_LIMITS[..., 0], _LIMITS[..., 1]))
    moved = from_swing_and_twist(angles.flatten(0, 1)).unflatten(0, (count, frames))
    return torch.where(joints[:, None, :, None, None], moved, windows)
