"""Channels: what each control's own location and rotation must be for it to stand where the transfer has it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .._exchange.rigs.roles import HELPER_OF
from .._exchange.so3 import quat_from_matrix, rotvec_from_quat, sign_continuous
from .motion.figures import Target
from .motion.transfer import Transferred


@dataclass(frozen=True)
class Channel:
    """One animated property of a control."""

    bone: str
    prop: str
    """``location`` or a rotation."""
    values: np.ndarray
    """(F, n) a column for each of its numbers."""


def channels_of(done: Transferred, target: Target, modes: dict[str, str]) -> list[Channel]:
    """Return what is keyed: rotations of all controls, and the location of those that have a way of their own.

    With r the axes at rest and D the rotations of a control and of the one it turns with,
    ``basis = r^T D_with^T D r``; its location is ``l^T D_with^T (p - p_carried)`` with l the axes that it counts along.

    Args:
        done: from ``transfer``.
        target: the rig.
        modes: rotation mode of each bone.
    """
    channels, r = [], target.axes[:, None]
    undone = np.where((target.turns_with < 0)[:, None, None, None], np.eye(3), done.turns[target.turns_with])
    undone = undone.swapaxes(-1, -2)
    basis = r.swapaxes(-1, -2) @ undone @ done.turns @ r
    quat = sign_continuous(np.moveaxis(quat_from_matrix(basis), 0, 1))
    for c, (name, role) in enumerate(zip(target.names, target.roles, strict=True)):
        part = role.partition("_")[2]
        if (part in HELPER_OF and part != "toe_ik") or c == done.carrier or role == "root":
            m = target.moves_with[c]
            if m >= 0:
                carried = done.places[m] + (done.turns[m] @ (target.heads[c] - target.heads[m]))
            else:
                carried = target.heads[c]
            way = target.place_axes[c].T @ undone[c] @ (done.places[c] - carried)[..., None]
            channels.append(Channel(name, "location", way[..., 0] / target.unit_m))
        if not part.endswith("pole"):
            channels.append(_rotation(name, modes[name], basis[c], quat[:, c]))
    return channels


def _rotation(bone: str, mode: str, R: np.ndarray, quat: np.ndarray) -> Channel:
    """Return a rotation, given as (F, 3, 3) and as (F, 4), in a bone's mode."""
    if mode == "QUATERNION":
        return Channel(bone, "rotation_quaternion", quat)
    if mode == "AXIS_ANGLE":
        rotvec = rotvec_from_quat(quat)
        angle = np.linalg.norm(rotvec, axis=-1, keepdims=True)
        axis = np.where(angle > 1e-9, rotvec / np.maximum(angle, 1e-9), np.array([0.0, 1.0, 0.0]))
        return Channel(bone, "rotation_axis_angle", np.concatenate([angle, axis], axis=1))
    return Channel(bone, "rotation_euler", euler_from_matrix(R, mode))


def euler_from_matrix(R: np.ndarray, order: str) -> np.ndarray:
    """Return continuous Euler angles: ``R = R_k(c) R_j(b) R_i(a)`` for the order "IJK", as Blender counts them.

    Of the two triples for a rotation, (a, b, c) and (a + π, π - b, c + π), each frame has the one nearer to the
    frame's before.

    Args:
        R: (F, 3, 3) rotations.
        order: such as ``XYZ``.

    Returns:
        (F, 3) radians about x, y and z.
    """
    i, j, k = ("XYZ".index(letter) for letter in order)
    sign = 1.0 if (i, j, k) in ((0, 1, 2), (1, 2, 0), (2, 0, 1)) else -1.0
    b = np.arcsin(np.clip(-sign * R[:, k, i], -1.0, 1.0))
    a = np.arctan2(sign * R[:, k, j], R[:, k, k])
    c = np.arctan2(sign * R[:, j, i], R[:, i, i])
    one = np.stack([a, b, c], axis=1)
    other = np.stack([a + np.pi, np.pi - b, c + np.pi], axis=1)
    stays, changes = (np.abs(_wrapped(next_[1:] - one[:-1])).sum(1) for next_ in (one, other))
    flipped = np.concatenate([[False], np.cumsum(changes < stays) % 2 == 1])
    angles = np.empty_like(one)
    angles[:, [i, j, k]] = np.unwrap(np.where(flipped[:, None], other, one), axis=0)
    return angles


def _wrapped(angle: np.ndarray) -> np.ndarray:
    return (angle + np.pi) % (2 * np.pi) - np.pi
