"""Pose body parts that have no measurements. They are relaxed and follow the trunk and gravity."""

from __future__ import annotations

import numpy as np

from solver_backend.body.body import Body
from solver_backend.geometry.rotations import exp_so3

_LIMBS = {
    "upper_arm": ("shoulder",),
    "forearm": ("elbow", "wrist"),
    "thigh": ("hip",),
    "shank": ("knee", "ankle", "foot"),
}
PARTS: dict[str, tuple[str, ...]] = {  # Joints that pose each part.
    "trunk": ("spine1", "spine2", "spine3", "left_collar", "right_collar"),
    "head": ("neck", "head"),
    **{f"{s}_{limb}": tuple(f"{s}_{j}" for j in joints) for limb, joints in _LIMBS.items() for s in ("left", "right")},
}
FLEXION_DEG = {"spine1": 3.0, "spine2": 3.0, "spine3": 4.0, "neck": -4.0, "head": -4.0, "elbow": 25.0, "knee": 6.0}
"""Forward flexion of resting joints in degrees (backward for knees), close to the medians in CMU recordings."""
ASIDE = {"shoulder": 0.2, "hip": 0.03}  # Outward to downward ratio of a hanging limb, so that an arm clears the hip.
ALONG_TRUNK = {"shoulder": 0.2, "hip": 0.05}  # The same ratio along the trunk, for a limb that cannot hang.


def rest_rotations(body: Body, root: np.ndarray, local: np.ndarray, parts: tuple[str, ...]) -> np.ndarray:
    """Replace the local rotations of the given body parts by a relaxed posture.

    The trunk is upright on the pelvis, and the head is upright on the trunk. An upper arm hangs in the direction
    ``(o, -(max(-g_y, 0) + k), max(g_z, 0))`` in the chest's axes (left, up, front). g is the direction of gravity in
    these axes, o points away from the trunk, and k is ``ALONG_TRUNK``. The arm therefore points down while the trunk
    leans forward, but never points into or behind the trunk. Thighs hang from the pelvis in the same way.

    Args:
        root: (F, 3, 3) body to world, Z up.
        local: (F, n, 3, 3) rotations of the joints after the root.
        parts: keys of ``PARTS``. Joints that the body does not have are skipped.
    """
    joints, rest, local = body.layout.joints, body.joints_template, local.copy()
    turned = {joints.index(name) for part in parts for name in PARTS[part] if name in joints}
    G = [root]
    for j in range(1, 1 + local.shape[1]):
        if j in turned:
            name = joints[j].removeprefix("left_").removeprefix("right_")
            if name in ASIDE:
                frame = joints.index("spine3") if name == "shoulder" else 0
                end = rest[body.layout.main_child[j]] - rest[j]
                hanging = G[frame] @ _turn_to(end, _hanging(G[frame], name, np.sign(end[0])))
                local[:, j - 1] = np.swapaxes(G[body.parents[j]], -1, -2) @ hanging
            else:
                local[:, j - 1] = exp_so3(_bend(name, joints[j]))
        G.append(G[body.parents[j]] @ local[:, j - 1])
    return local


def _bend(name: str, joint: str) -> np.ndarray:
    """Return a relaxed joint's rotation vector. Elbows bend about the vertical axis, others about the left axis."""
    angle = np.radians(FLEXION_DEG.get(name, 0.0))
    if name == "elbow":
        return np.array([0.0, -angle if joint.startswith("left") else angle, 0.0])
    return np.array([angle, 0.0, 0.0])


def _hanging(frame: np.ndarray, name: str, side: float) -> np.ndarray:
    """Return the unit directions (F, 3) in which a limb hangs, in the axes of the trunk or pelvis (F, 3, 3)."""
    gravity = -frame[:, 2]
    down = np.maximum(-gravity[:, 1], 0.0) + ALONG_TRUNK[name]
    outwards = side * (ASIDE[name] * down + np.maximum(side * gravity[:, 0], 0.0))
    direction = np.stack([outwards, -down, np.maximum(gravity[:, 2], 0.0)], axis=-1)
    return direction / np.linalg.norm(direction, axis=-1, keepdims=True)


def _turn_to(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return the smallest (F, 3, 3) rotations from a direction (3,) to unit directions (F, 3)."""
    start = start / np.linalg.norm(start)
    axis = np.cross(start, end)
    sine = np.linalg.norm(axis, axis=-1, keepdims=True)
    angle = np.arctan2(sine, (end @ start)[:, None])
    return exp_so3(axis * angle / np.maximum(sine, 1e-12))
