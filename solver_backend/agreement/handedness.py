"""Whether keypoints in space are a body's or its mirror image: where left, up and forward point against each other."""

from __future__ import annotations

import numpy as np

from solver_backend.types import JointSet

SURE = 0.2
"""From here on handedness is no noise: the demo, recorded people and simulated takes reach 0.5 to 0.6 over their
length, and 0.27 in a stretch of salsa."""
_SLIGHT = 0.1
"""Share of the trunk's length that is added to each part's: what hardly leaves the plane counts little, such as knees
of a person who stands."""


def handedness(points: np.ndarray, joint_set: JointSet) -> float:
    """Return how clearly keypoints are those of a body, up to 1, or of its mirror image, down to -1; 0 where unknown.

    With left ``l`` and up ``u`` of the trunk, ``n = l x u`` points forward. Before it are, in every person, toes of
    ankles, a nose of ears and eyes, and a bent knee of hip and ankle: the sum of these parts' lengths along n over that
    of their lengths across u.

    Args:
        points: (F, K, 3) world, NaN where unknown.
        joint_set: names of the K keypoints.
    """
    place = {name: points[:, k] for k, name in enumerate(joint_set.keypoints)}
    trunk = ("left_shoulder", "right_shoulder", "left_hip", "right_hip")
    if any(name not in place for name in trunk) or not (parts := _forward_parts(place)):
        return 0.0
    shoulder_l, shoulder_r, hip_l, hip_r = (place[name] for name in trunk)
    up, left = shoulder_l + shoulder_r - hip_l - hip_r, shoulder_l - shoulder_r + hip_l - hip_r
    with np.errstate(invalid="ignore", divide="ignore"):
        height = np.linalg.norm(up, axis=-1)
        up = up / height[:, None]
        forward = np.cross(left, up)
        forward /= np.linalg.norm(forward, axis=-1, keepdims=True)
    across = np.stack(parts)
    across = across - (across * up).sum(-1, keepdims=True) * up
    along, length = (across * forward).sum(-1), np.linalg.norm(across, axis=-1) + _SLIGHT * height / 2
    known = np.isfinite(along)
    return float(along[known].sum() / length[known].sum()) if known.any() else 0.0


def _forward_parts(place: dict[str, np.ndarray]) -> list[np.ndarray]:
    """Return the vectors (F, 3) that point forward in every person."""
    parts = list[np.ndarray]()
    for side in ("left", "right"):
        names = ("hip", "knee", "ankle", "big_toe", "ear", "eye")
        hip, knee, ankle, toe, ear, eye = (place.get(f"{side}_{name}") for name in names)
        if toe is not None and ankle is not None:
            parts.append(toe - ankle)
        if knee is not None and hip is not None and ankle is not None:
            parts.append(knee - (hip + ankle) / 2)
        parts += [place["nose"] - other for other in (ear, eye) if other is not None and "nose" in place]
    return parts
