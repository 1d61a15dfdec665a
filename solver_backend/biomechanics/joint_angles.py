"""Compute joint angles between adjacent segments, with standard deviations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from solver_backend.biomechanics.segments import SEGMENTS, PosedSegments
from solver_backend.geometry.rotations import exp_so3, log_so3
from solver_backend.types.shapes import Float

X, Y, Z = np.eye(3)
FLEXION = (Z, X, Y)
"""Rotations about the hinge, the floating axis and the long axis (Grood and Suntay 1983), as in ISB and OpenSim."""
ELEVATION = (Y, X, Y)
"""Plane of elevation, elevation and axial rotation of the upper arm (Wu et al. 2005, section 2.4.7)."""
HEADING = (Y, X, Z)
"""Rotation, list and tilt of the pelvis. With Y first, list and tilt do not depend on the heading (Baker 2001)."""
_STEPS = 6  # Newton steps. Angles about oblique axes converge to 1e-12 in four.


def successive_turns(R: Float[np.ndarray, "frames 3 3"], axes: Sequence[np.ndarray]) -> Float[np.ndarray, "frames 3"]:
    """Split rotations into angles (F, 3) in radians: ``R = exp(a1 θ1) exp(a2 θ2) exp(a3 θ3)``.

    The orders z-x-y, y-x-y and y-x-z have closed forms. For oblique axes close to z-x-y, such as the ankle's, the
    closed form of z-x-y gives the initial angles of Newton's method ``θ += J⁻¹ log(R R(θ)ᵀ)``, with ``J`` from
    ``axes_in_parent``. The second angle is between -90 and 90 degrees, or between -180 and 0 for y-x-y. The first and
    third angle are unwrapped, so that their means are within ±180 degrees. When a motion passes through gimbal lock,
    the first and third angle jump by 180 degrees. When it circles around gimbal lock, they grow by 360 degrees per
    circle.
    """
    if axes is ELEVATION:
        second = -np.arccos(np.clip(R[:, 1, 1], -1.0, 1.0))
        turns = np.stack([np.arctan2(-R[:, 0, 1], -R[:, 2, 1]), second, np.arctan2(-R[:, 1, 0], R[:, 1, 2])], axis=-1)
    elif axes is HEADING:
        second = -np.arcsin(np.clip(R[:, 1, 2], -1.0, 1.0))
        turns = np.stack([np.arctan2(R[:, 0, 2], R[:, 2, 2]), second, np.arctan2(R[:, 1, 0], R[:, 1, 1])], axis=-1)
    else:
        first, third = np.arctan2(-R[:, 0, 1], R[:, 1, 1]), np.arctan2(-R[:, 2, 0], R[:, 2, 2])
        turns = np.stack([first, np.arcsin(np.clip(R[:, 2, 1], -1.0, 1.0)), third], axis=-1)
        for _ in range(0 if axes is FLEXION else _STEPS):
            left = log_so3(R @ np.swapaxes(_rotation(turns, axes), -1, -2))
            turns = turns + np.einsum("fij,fj->fi", np.linalg.pinv(axes_in_parent(turns, axes)), left)
    turns = np.unwrap(turns, axis=0)
    return turns - 2.0 * np.pi * np.round(turns.mean(axis=0) / (2.0 * np.pi))


def axes_in_parent(turns: np.ndarray, axes: Sequence[np.ndarray]) -> Float[np.ndarray, "frames 3 3"]:
    """Return the three rotation axes as columns (F, 3, 3), in the axes of the parent segment.

    The second axis is rotated by the first angle, and the third axis by the first two angles. The axes form the
    Jacobian J in ``d = J dθ``, where d is a left-applied rotation vector and θ are the angles.
    """
    first = exp_so3(turns[:, :1] * axes[0])
    second = first @ exp_so3(turns[:, 1:2] * axes[1])
    columns = [np.broadcast_to(axes[0], (len(turns), 3)), first @ axes[1], second @ axes[2]]
    return np.stack(columns, axis=-1)


def _rotation(turns: np.ndarray, axes: Sequence[np.ndarray]) -> np.ndarray:
    parts = [exp_so3(turns[:, i : i + 1] * axis) for i, axis in enumerate(axes)]
    return parts[0] @ parts[1] @ parts[2]


@dataclass(frozen=True)
class JointRule:
    """Rule that derives up to three named angles from a segment's rotation relative to its parent."""

    names: tuple[str, ...]  # Names of up to three angles, "" for one that is not reported.
    axes: Sequence[np.ndarray] = FLEXION
    signs: tuple[float, float, float] = (1.0, 1.0, 1.0)


ISB: dict[str, JointRule] = {
    "pelvis": JointRule(("rotation", "list", "tilt"), HEADING),
    "thorax": JointRule(("extension", "bending_to_right", "rotation_to_left")),
    "head": JointRule(("extension", "bending_to_right", "rotation_to_left")),
    "thigh": JointRule(("flexion", "adduction", "internal_rotation")),
    "shank": JointRule(("flexion", "adduction", "internal_rotation"), signs=(-1.0, 1.0, 1.0)),
    "foot": JointRule(("dorsiflexion", "inversion", "internal_rotation")),
    "upper_arm": JointRule(("plane_of_elevation", "elevation", "internal_rotation"), ELEVATION, (1.0, -1.0, 1.0)),
    "forearm": JointRule(("flexion", "adduction", "pronation")),
    "hand": JointRule(("flexion", "ulnar_deviation", "")),
}
"""Angles by segment name without side. On both sides they are positive in the direction of their name. Pelvic tilt is
positive backwards."""
JOINT_WORDS = {
    "pelvis": "pelvis", "thorax": "spine", "head": "neck", "thigh": "hip", "shank": "knee", "foot": "ankle",
    "upper_arm": "shoulder", "forearm": "elbow", "hand": "wrist",
}  # fmt: skip


@dataclass(frozen=True)
class Angles:
    """Joint angles (F, A) in F frames, with standard deviations."""

    names: tuple[str, ...]
    degrees: Float[np.ndarray, "frames angles"]
    deviations: Float[np.ndarray, "frames angles"] | None  # Standard deviations in degrees, NaN where unknown.

    def column(self, name: str) -> np.ndarray:
        """Return one joint angle (F,) in degrees."""
        return self.degrees[:, self.names.index(name)]


def isb_angles(posed: PosedSegments, covariances: dict[str, np.ndarray] | None = None) -> Angles:
    """Compute the ISB joint angles of all segments, with names such as ``left_knee_flexion``.

    Args:
        covariances: (F, 3, 3) covariances in rad² of each segment's rotation, in the parent segment's joint frame.
    """
    names, columns, deviations = [], [], []
    for segment in SEGMENTS:
        side, _, bare = segment.partition("_") if segment.startswith(("left_", "right_")) else ("", "", segment)
        if (rule := ISB.get(bare)) is None:
            continue
        turns = successive_turns(posed.relative(segment), rule.axes)
        spread = None if covariances is None else turn_deviations(turns, rule.axes, posed, segment, covariances)
        for i, name in enumerate(rule.names):
            if name:
                names.append("_".join(filter(None, (side, JOINT_WORDS[bare], name))))
                columns.append(np.degrees(rule.signs[i] * turns[:, i]))
                deviations.append(None if spread is None else np.degrees(spread[:, i]))
    known = None if covariances is None else np.stack(deviations, axis=-1)
    return Angles(tuple(names), np.stack(columns, axis=-1), known)


def turn_deviations(
    turns: np.ndarray,
    axes: Sequence[np.ndarray],
    posed: PosedSegments,
    segment: str,
    covariances: dict[str, np.ndarray],
) -> Float[np.ndarray, "frames 3"]:
    """Return (F, 3) standard deviations of joint angles in radians: ``sqrt(diag(J⁻¹ C J⁻ᵀ))``.

    J is ``axes_in_parent``, and C the covariance of the left-applied rotation in the parent segment's axes. Near gimbal
    lock, J is almost singular: only the sum of two angles is known, and their deviations grow up to π.
    """
    frame = posed.above[segment]
    C = np.swapaxes(frame, -1, -2) @ covariances[segment] @ frame
    if segment.startswith("left_"):
        C = C * np.outer((1.0, 1.0, -1.0), (1.0, 1.0, -1.0))  # A reflection negates rotations about x and y.
    inverse = np.linalg.pinv(axes_in_parent(turns, axes), rcond=1e-9)
    variance = np.einsum("fij,fjk,fik->fi", inverse, C, inverse)
    return np.minimum(np.sqrt(np.maximum(variance, 0.0)), np.pi)
