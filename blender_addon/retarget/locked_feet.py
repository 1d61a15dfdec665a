"""Lock the planted feet in a take from any program, and keep all hand edits."""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np

from .._exchange.limb_bend import bend_to, eased, longest_reach, swing, within_reach
from .._exchange.motion_file import read_motion
from .._exchange.so3 import matrix_from_rotvec, quat_from_matrix, rotvec_from_quat
from .._exchange.stands import stands, steps
from ..animation.key_reduction import posed_joints, rest_of
from ..animation.layers import without_layers
from ..animation.takes import take_file
from ..scene.bake import add_edited_take
from ..scene.hand_edits import played_channels, take_times

_LEGS = ((1, 4, 7, 10), (2, 5, 8, 11))  # Hip, knee, ankle and ball of each leg, as SMPL joint numbers.
_ANKLES = [leg[2] for leg in _LEGS]
_HEEL_BEHIND = 0.35
"""Distance of the heel behind the ankle, relative to the horizontal distance from ankle to ball (add-on's body)."""
_EASE_S = 0.15  # Seconds before and after a contact during which the foot blends with its original path.
LOCKED = " locked feet"  # Suffix of the name of each take that Lock Feet creates.


@dataclass(frozen=True)
class LockedFeet:
    """A take with locked feet, and measured values of the correction."""

    action: bpy.types.Action
    stands: int  # Number of locked contacts of a heel or ball.
    slid_mm: float  # Largest slide during a contact before the correction, in millimetres.


def lock_feet(
    scene: bpy.types.Scene, take: bpy.types.Action, armature: bpy.types.Object, longest_slide_mm: float
) -> LockedFeet | None:
    """Add and play a take with locked feet. Return None if no foot is planted."""
    motion = read_motion(take_file(take, "motion_file"))
    with without_layers(armature):
        channels = played_channels(scene, armature, take_times(take, motion))
    locked, feet = _hold_feet(channels, *rest_of(armature), motion.fps, longest_slide_mm / 1000.0)
    stands = sum(foot.stands for foot in feet)
    if not stands:
        return None
    action = add_edited_take(scene, take, armature, f"{take.name.removesuffix(LOCKED)}{LOCKED}", locked)
    return LockedFeet(action, stands, 1000.0 * max(foot.slid_m for foot in feet))


def _hold_feet(
    channels: np.ndarray, heads: np.ndarray, axes: np.ndarray, fps: float, longest_slide_m: float
) -> tuple[np.ndarray, list[_Foot]]:
    """Return channels with heels and balls fixed during each contact, and the paths of both feet.

    If heel and ball both touch the floor, the foot is rotated by the smallest angle to its mean direction, which moves
    the ankle. Each leg bends in its hip-knee-ankle plane to reach the ankle. If it is too short, the pelvis moves.
    """
    if len(channels) < 3:
        return channels, []
    G, p = posed_joints(channels, heads, axes)
    feet = [_held_foot(G, p, heads, axes, leg, fps, longest_slide_m) for leg in _LEGS]
    way, turned = _bent_legs(G, p, axes, feet)
    changed = channels.copy()
    changed[:, :3] += way @ axes[0]
    for hip, knee, ankle, _ in _LEGS:
        for parent, joint in ((0, hip), (hip, knee), (knee, ankle)):
            local = axes[joint].T @ axes[parent] @ np.swapaxes(turned[:, parent], -1, -2) @ turned[:, joint]
            changed[:, 3 + 4 * joint : 7 + 4 * joint] = quat_from_matrix(local)
    moved = np.abs(np.stack([foot.ankle for foot in feet], axis=1) - p[:, _ANKLES]).max(axis=(1, 2)) > 0.0
    return np.where(moved[:, None], _same_signs(changed, channels), channels), feet


def _bent_legs(G: np.ndarray, p: np.ndarray, axes: np.ndarray, feet: list[_Foot]) -> tuple[np.ndarray, np.ndarray]:
    bones = [(p[:, knee] - p[:, hip], p[:, ankle] - p[:, knee]) for hip, knee, ankle, _ in _LEGS]
    ankles = np.stack([foot.ankle for foot in feet])
    hips, reaches = np.stack([p[:, leg[0]] for leg in _LEGS]), np.stack([longest_reach(*bone) for bone in bones])
    way, turned = within_reach(hips, ankles, reaches), G.copy()
    for leg, (hip, knee, ankle, ball), (upper, lower), foot in zip(range(2), _LEGS, bones, feet, strict=True):
        hinge = G[:, knee] @ axes[knee].T @ [1.0, 0.0, 0.0]
        turn_upper, turn_lower = bend_to(ankles[leg] - hips[leg] - way, upper, lower, hinge)
        turned[:, hip], turned[:, knee] = turn_upper @ G[:, hip], turn_lower @ G[:, knee]
        turned[:, ankle], turned[:, ball] = foot.turn @ G[:, ankle], foot.turn @ G[:, ball]
    return way, turned


@dataclass(frozen=True)
class _Foot:
    ankle: np.ndarray  # (F, 3) position of the ankle.
    turn: np.ndarray  # (F, 3, 3) rotation of the foot about the ankle.
    stands: int
    slid_m: float


def _held_foot(
    G: np.ndarray,
    p: np.ndarray,
    heads: np.ndarray,
    axes: np.ndarray,
    leg: tuple[int, ...],
    fps: float,
    longest: float,
) -> _Foot:
    """Return a foot's ankle positions and rotations with its heel and ball locked during contacts."""
    ankle, ball = leg[2:]
    forward = (heads[ball] - heads[ankle]) * [1.0, 1.0, 0.0]
    behind = heads[ball] - (1.0 + _HEEL_BEHIND) * forward - heads[ankle]
    from_ankle = np.stack([G[:, ankle] @ axes[ankle].T @ behind, p[:, ball] - p[:, ankle]], axis=1)
    points = p[:, ankle, None] + from_ankle
    way, seconds = steps(points, fps)
    planted, anchors = np.zeros(points.shape[:2], bool), points.copy()
    count, slid = 0, 0.0
    for k, runs in enumerate(stands(points[..., 2], np.linalg.norm(way, axis=-1) / seconds, fps)):
        for first, stop in runs:
            where = points[first:stop, k].mean(axis=0)
            far = float(np.linalg.norm(points[first:stop, k] - where, axis=1).max())
            if far <= longest:
                planted[first:stop, k], anchors[first:stop, k] = True, where
                count, slid = count + 1, max(slid, far)
    turn = _turned(planted.all(axis=1), from_ankle[:, 1] - from_ankle[:, 0], anchors[:, 1] - anchors[:, 0], fps)
    off = anchors - p[:, ankle, None] - (turn[:, None] @ from_ankle[..., None])[..., 0]
    weights = planted / np.maximum(planted.sum(axis=1, keepdims=True), 1)
    stood = np.flatnonzero(planted.any(axis=1))
    shift = (weights[..., None] * off).sum(axis=1)
    return _Foot(p[:, ankle] + eased(shift, stood, _EASE_S * fps), turn, count, slid)


def _turned(both: np.ndarray, now: np.ndarray, held: np.ndarray, fps: float) -> np.ndarray:
    """Return the rotations (F, 3, 3) that align a foot with its locked direction. They are eased in and out."""
    turn = np.zeros_like(now)
    turn[both] = rotvec_from_quat(quat_from_matrix(swing(now[both], held[both])))
    return matrix_from_rotvec(eased(turn, np.flatnonzero(both), _EASE_S * fps))


def _same_signs(changed: np.ndarray, channels: np.ndarray) -> np.ndarray:
    """Give the quaternions in ``changed`` the signs that they have in ``channels``. q and -q are the same rotation."""
    new, old = (values[:, 3:].reshape(len(values), -1, 4) for values in (changed, channels))
    signs = np.where((new * old).sum(-1, keepdims=True) < 0, -1.0, 1.0)
    return np.concatenate([changed[:, :3], (signs * new).reshape(len(changed), -1)], axis=1)
