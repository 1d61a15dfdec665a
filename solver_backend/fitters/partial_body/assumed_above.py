"""Feet alone, or lower legs alone: where the rest of the body is above them, nothing measures and a posture assumes."""

from __future__ import annotations

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.landmark_set import Landmarks
from solver_backend.exchange.body_layout import BodyLayout
from solver_backend.geometry.symmetric import packed, unpacked

NEAR_ROOT = (
    "pelvis", "left_hip", "right_hip", "spine1", "spine2", "spine3", "neck", "left_collar", "right_collar", "head",
)  # fmt: skip
"""Bones whose landmarks place the body: pelvis, trunk, head, thighs."""
NEAR_KNEE_M = 0.12
"""A landmark of the thigh so near to the knee is the knee's: an epicondyle is 68 mm from it, the patella 73."""
KNEE_SIGMA_M, ABOVE_FEET_SIGMA_M, ABOVE_SHANKS_SIGMA_M = 0.04, 0.08, 0.055
"""Deviation per axis of knees above feet, of all that is above them, and of what is above measured lower legs: two
takes, CMU's walk and the demo, are off by 25 and 90 mm, 61 and 183, 23 and 131 from the solve of all their markers."""


def assumed_joints(body: Body, landmarks: Landmarks, located: np.ndarray) -> tuple[str, ...]:
    """Return the joints whose places only a posture determines; none where a landmark near the root is ever located.

    A landmark measures the joint of the bone that carries it and the joints below that bone. One on the thigh near the
    knee shows where the knee is, and not where the thigh comes from.

    Args:
        body: whose tree.
        landmarks: L landmarks.
        located: (F, L) bool.
    """
    names, parents = body.layout.joints, body.parents
    carriers = set(_carriers(body, landmarks)[located.any(axis=0)].tolist())
    if not carriers or any(names[j] in NEAR_ROOT for j in carriers):
        return ()
    measured = carriers | {j for j, parent in enumerate(parents) if parent in carriers}
    return tuple(name for j, name in enumerate(names) if j not in measured)


def _carriers(body: Body, landmarks: Landmarks) -> np.ndarray:
    """Return (L,) the joint of the bone that carries each landmark; of a thigh's lower end the knee."""
    carriers, places = np.argmax(landmarks.weights, axis=1), landmarks.anchors.sum(axis=1)
    for side in ("left", "right"):
        if {f"{side}_hip", f"{side}_knee"} <= set(body.layout.joints):
            hip, knee = (body.layout.joints.index(f"{side}_{part}") for part in ("hip", "knee"))
            near = np.linalg.norm(places - body.joints_template[knee], axis=1) < NEAR_KNEE_M
            carriers = np.where((carriers == hip) & near, knee, carriers)
    return carriers


def with_assumed_spread(covariance: np.ndarray, layout: BodyLayout, assumed: tuple[str, ...]) -> np.ndarray:
    """Return (F, J, 6) covariances in m² with ``σ² I`` added to those of assumed joints, see the constants."""
    found = unpacked(covariance)
    feet_alone = any(name.endswith("knee") for name in assumed)
    above = ABOVE_FEET_SIGMA_M if feet_alone else ABOVE_SHANKS_SIGMA_M
    for name in assumed:
        if name in layout.joints:
            sigma = KNEE_SIGMA_M if name.endswith("knee") else above
            found[:, layout.joints.index(name)] += sigma**2 * np.eye(3)
    return packed(found)
