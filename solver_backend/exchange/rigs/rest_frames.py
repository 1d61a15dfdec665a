"""Define rest frames for limbs, so that bones are compared by body part and never by their axes.

The stage has Z up. A figure on it faces -Y with its left side towards +X.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..diagnostics import Diagnostic, diagnostic
from .skeleton import LIMBS, SIDES

LEFT, FORWARD, UP = np.eye(3)[0], -np.eye(3)[1], np.eye(3)[2]
_BENT = np.sin(np.radians(8.0))
"""Sine of the smallest bend of a hinge that defines its axis at rest."""
_LIKELY = 0.5  # Smallest cosine between that axis and the anatomical axis.
_BENT_REST_DEG = 50.0  # Largest knee or elbow bend in a standing pose, in degrees.
_STANDS_DEG = 30.0  # Largest lean of the trunk, thighs and shins of an upright figure, in degrees.
_ACROSS = 1e-3  # Smallest sideways fraction of the vector from right to left. Below it, one side is above the other.
_SNAP = np.cos(np.radians(12.0))  # Cosine of the angle below which a facing direction snaps to a skeleton axis.


def stage_axes(places: Mapping[str, np.ndarray]) -> np.ndarray | None:
    """Return the rotation from a skeleton's axes to Z up and -Y forwards. None if left and right are unknown.

    Args:
        places: maps roles to (3,) head positions at rest, including the pelvis or the feet.
    """
    above = next(role for role in ("head", "neck_1", "left_upper_arm", "right_upper_arm", *places) if role in places)
    feet = [places[f"{side}_foot"] for side in SIDES if f"{side}_foot" in places]
    rise = places[above] - (np.mean(feet, axis=0) if feet else places["pelvis"])
    up = np.eye(3)[np.abs(rise).argmax()] * np.sign(rise[np.abs(rise).argmax()])
    pairs = [p for p in ("thigh", "upper_arm", "shin", "clavicle") if all(f"{s}_{p}" in places for s in SIDES)]
    if not pairs:
        return None
    left = sum((places[f"left_{part}"] - places[f"right_{part}"] for part in pairs), np.zeros(3))
    across = left - (left @ up) * up
    if np.linalg.norm(across) <= _ACROSS * np.linalg.norm(left):
        return None
    left = across / np.linalg.norm(across)
    nearest = np.abs(left).argmax()
    if abs(left[nearest]) > _SNAP:
        left = np.eye(3)[nearest] * np.sign(left[nearest])
    return np.stack([left, np.cross(up, left), up])


def bent_at_rest(places: Mapping[str, np.ndarray]) -> Diagnostic | None:
    """Return a diagnostic if a limb is bent in the rest pose, for example because it is a clip's first frame.

    Args:
        places: maps roles to (3,) head positions at rest.
    """
    for roles in LIMBS.values():
        if set(roles) <= places.keys():
            a, b, c = (places[role] for role in roles)
            u, v = b - a, c - b
            angle = float(_angles_deg(u, v))
            if angle > _BENT_REST_DEG:
                return diagnostic("motion_rest_bent", part=roles[1].replace("_", " "), angle=angle)
    return None


def off_stance_deg(places: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the (...) angle between trunk and legs in degrees, or 0 if it is unknown.

    The angle is close to 0 for upright figures.

    Args:
        places: maps roles to (..., 3) head positions, at rest or in any pose.
    """
    line = _trunk_and_legs(places)
    return np.zeros(places["pelvis"].shape[:-1]) if line is None else _angles_deg(line[0], -line[1])


def standing_frame(places: Mapping[str, np.ndarray], up: np.ndarray) -> int | None:
    """Return the frame in which the figure stands straightest, or None if it never stands.

    Args:
        places: maps roles to (F, 3) head positions.
        up: (F, 3) up directions.
    """
    line = _trunk_and_legs(places)
    if line is None:
        return None
    off = [_angles_deg(line[0], up), _angles_deg(line[1], -up)]
    for side in SIDES:
        thigh, shin, foot = (places[role] for role in LIMBS[f"{side}_leg"])
        off += [_angles_deg(shin - thigh, -up), _angles_deg(foot - shin, -up)]
    worst = np.max(off, axis=0)
    frame = int(np.square(off).sum(axis=0).argmin())
    return frame if worst[frame] < _STANDS_DEG else None


def _trunk_and_legs(places: Mapping[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray] | None:
    tops = [(role,) for role in ("neck_1", "head")] + [("left_upper_arm", "right_upper_arm")]
    top = next((roles for roles in tops if set(roles) <= places.keys()), None)
    if top is None or not all(set(LIMBS[f"{side}_leg"]) <= places.keys() for side in SIDES):
        return None
    hips, feet = (np.mean([places[f"{side}_{part}"] for side in SIDES], axis=0) for part in ("thigh", "foot"))
    return np.mean([places[role] for role in top], axis=0) - hips, feet - hips


def _angles_deg(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    lengths = np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1)
    return np.degrees(np.arccos(np.clip((a * b).sum(-1) / np.maximum(lengths, 1e-12), -1.0, 1.0)))


def limb_turns(points: np.ndarray, own: np.ndarray, is_arm: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return the (3, 3) rotations that align both bones of a limb at rest with the limb of another figure.

    The columns of a bone's frame M are its direction, the hinge, and the normal to both. The rotation is
    ``A = M_own M_points^T``.

    Args:
        points: (3, 3) rest positions of hip, knee and ankle, or of shoulder, elbow and wrist, with Z up and -Y
            forwards.
        own: (3, 3) the same positions for the other figure. Its limbs bend about their anatomical axes.
    """
    turns = []
    for a, b in ((0, 1), (1, 2)):
        direction, there = points[b] - points[a], own[b] - own[a]
        frame = limb_frame(there, anatomical_axis(there, is_arm))
        turns.append(frame @ limb_frame(direction, _hinge(points, direction, is_arm)).T)
    return turns[0], turns[1]


def anatomical_axis(direction: np.ndarray, is_arm: bool) -> np.ndarray:
    """Return the axis about which a straight limb bends (elbows forwards, knees to the left)."""
    return np.cross(direction, FORWARD) if is_arm else LEFT


def limb_frame(direction: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Return the (..., 3, 3) right-handed frame of a direction and an axis.

    Args:
        direction: (..., 3) non-zero vectors.
        axis: (..., 3) vectors. They are made orthogonal to the direction. If one is parallel to the direction, any
            other axis is used.
    """
    x = direction / np.linalg.norm(direction, axis=-1, keepdims=True)
    y = axis - (axis * x).sum(-1, keepdims=True) * x
    other = np.eye(3)[np.abs(x).argmin(-1)]
    other = other - (other * x).sum(-1, keepdims=True) * x
    length = np.linalg.norm(y, axis=-1, keepdims=True)
    y = np.where(length < 1e-6, other, y)
    y = y / np.linalg.norm(y, axis=-1, keepdims=True)
    return np.stack([x, y, np.cross(x, y)], axis=-1)


def level(direction: np.ndarray) -> np.ndarray:
    """Return the horizontal part of a direction (3,), or the forward direction if it is vertical."""
    flat = direction * [1.0, 1.0, 0.0]
    return flat if np.linalg.norm(flat) > 1e-4 else FORWARD


def swing(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the smallest rotations (..., 3, 3) that map directions ``a`` to ``b``."""
    axis = np.cross(a, b)
    return limb_frame(b, axis) @ limb_frame(a, axis).swapaxes(-1, -2)


def _hinge(points: np.ndarray, direction: np.ndarray, is_arm: bool) -> np.ndarray:
    """Return a limb's hinge axis at rest: the axis of its bend, or the anatomical axis if the bend is unclear."""
    u, v = points[1] - points[0], points[2] - points[1]
    bend, expected = np.cross(u, v), anatomical_axis(direction, is_arm)
    size = np.linalg.norm(bend)
    if size < _BENT * np.linalg.norm(u) * np.linalg.norm(v):
        return expected
    return bend if bend @ expected > _LIKELY * size * np.linalg.norm(expected) else expected
