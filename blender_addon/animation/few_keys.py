"""A take with few keys: how an action is thinned, and how far the result is from the take."""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np

from .._exchange.so3 import matrix_from_quat
from ..conventions.skeleton import LAYOUTS, layout_of
from .key_reduction import keys_within, reduce_keys
from .sparse_curves import SparseCurves


@dataclass(frozen=True)
class KeyDeviation:
    """Largest differences between a take with few keys and the full take, over all its frames and joints."""

    keys: int
    """Keys that are left."""
    joints_mm: float
    """Joint positions."""
    degrees: float
    """Rotations of the joints against their parents."""

    def __str__(self) -> str:
        return (
            f"{self.keys} keys are left: joints are up to {self.joints_mm:.1f} mm and {self.degrees:.1f}° "
            "from the take."
        )


def thin_channels(
    channels: np.ndarray,
    armature: bpy.types.Object,
    keyframes: np.ndarray | None,
    count: int,
    tolerance_mm: float | None = None,
) -> tuple[SparseCurves, KeyDeviation]:
    """Return the channels of an armature with few keys.

    Args:
        channels: (F, 3 + 4 J) location of the pelvis and quaternions wxyz of the bones, in their own rest axes.
        armature: whose channels they are.
        keyframes: (F,) frames that may keep a key; None for any.
        count: keys at most.
        tolerance_mm: instead of ``count``, how far any joint may be from the full take; keys may then lie anywhere.
    """
    frames = len(channels)
    candidates = np.arange(frames) if keyframes is None else np.flatnonzero(keyframes)
    heads, axes = rest_of(armature)
    joints = posed_joints(channels, heads, axes)[1]

    def apart(first: int, found: np.ndarray) -> np.ndarray:
        """Return (n,) metres by which the joint farthest off is off."""
        off = posed_joints(found, heads, axes)[1] - joints[first : first + len(found)]
        return np.linalg.norm(off, axis=-1).max(axis=1)

    if tolerance_mm is None:
        curves = reduce_keys(channels, candidates, max(2, count), apart)
    else:
        curves = keys_within(channels, apart, 1e-3 * tolerance_mm)
    found = curves.sampled(frames)
    cosine = np.abs((_quaternions(found) * _quaternions(channels)).sum(-1)).clip(max=1)
    return curves, KeyDeviation(
        keys=len(curves.frames),
        joints_mm=float(1000 * apart(0, found).max()),
        degrees=float(np.degrees(2 * np.arccos(cosine)).max()),
    )


def rest_of(armature: bpy.types.Object) -> tuple[np.ndarray, np.ndarray]:
    """Return heads (J, 3) and axes (J, 3, 3) of the bones at rest, in the armature's frame."""
    bones = armature.data.bones
    rest = np.array([bones[joint].matrix_local for joint in layout_of(bones).joints], dtype=np.float64)
    return rest[:, :3, 3], rest[:, :3, :3]


def _quaternions(channels: np.ndarray) -> np.ndarray:
    """Return the (F, J, 4) unit quaternions; Blender, too, scales those of a pose to length 1."""
    quat = channels[:, 3:].reshape(len(channels), -1, 4)
    return quat / np.linalg.norm(quat, axis=-1, keepdims=True)


def posed_joints(channels: np.ndarray, heads: np.ndarray, axes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return rotations (F, J, 3, 3) and places (F, J, 3) of bones in the armature's frame.

    ``G_j = G_p A_p^T A_j R_j``, ``p_j = p_p + G_p A_p^T (h_j - h_p)``.

    Args:
        channels: (F, 3 + 4 J), see ``thin_channels``.
        heads: (J, 3) h at rest.
        axes: (J, 3, 3) A at rest.
    """
    R = matrix_from_quat(_quaternions(channels))
    G, p = np.empty_like(R), np.empty(R.shape[:3])
    G[:, 0], p[:, 0] = axes[0] @ R[:, 0], heads[0] + channels[:, :3] @ axes[0].T
    parents = next(layout.parents for layout in LAYOUTS if layout.num_joints == len(heads))
    for j, parent in enumerate(parents[1:], 1):
        rotated = G[:, parent] @ axes[parent].T
        G[:, j] = rotated @ axes[j] @ R[:, j]
        p[:, j] = p[:, parent] + rotated @ (heads[j] - heads[parent])
    return G, p
