"""Place optical markers on the skin of any body by anatomical rules."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache, lru_cache
from typing import Any

import numpy as np

from solver_backend.body.anatomy import AtJoints, LandmarkBuilder, OnSurface, Rule
from solver_backend.body.body import Body
from solver_backend.body.joint_names import JOINT, KEYPOINT, is_joint_centre
from solver_backend.body.keypoints import keypoint_rules
from solver_backend.body.landmarks import Landmarks
from solver_backend.body.marker_layouts import load_layouts

ON_BONE = "@"  # Prefix for a location known only by its bone, which is given by its joint.
ON_BONE_SPREAD_M = 0.2  # Standard deviation in metres of such a marker's distance from the joint.
LIMB_JOINT_SPREAD_M, INNER_SPREAD_M = 0.004, 0.015
"""Standard deviations per axis between other skeletons' joint centres and the body's. From hip to ankle and from
shoulder to wrist, definitions agree except for detectors' hips. Necks, heads, hands and feet differ by up to a
decimetre. With more than 4 mm, elbow errors of an inertial suit reach 16 mm."""
_LIMB_JOINTS = ("hip", "knee", "ankle", "shoulder", "elbow", "wrist")
MARKER_OFFSET_M = 0.0095  # Distance from a marker's centre to the skin: the radius of a 14 mm marker, plus its base.


def marker_layout(name: str) -> tuple[str, ...]:
    """Return the marker names of a layout. Raise ``KeyError`` if there is no such layout."""
    return load_layouts().layouts[name]


@lru_cache(maxsize=16)
def marker_landmarks(body: Body, names: tuple[str, ...]) -> Landmarks:
    """Place markers by name 9.5 mm above the skin of a body, with pose correctives.

    ``@left_knee`` is the joint itself and moves with the bone below it. Joint centres (``=left_knee``) and keypoints
    (``~left_knee``) are inside the body and move only with the bones. An unknown name raises ``KeyError``, and a ray
    that misses the mesh raises ``BodyInvalid``.
    """
    inside = any(is_joint_centre(name) for name in names)
    return LandmarkBuilder(body, _rules_of(names, MARKER_OFFSET_M), correctives=not inside).build(names)


def placement_precision(body: Body, names: tuple[str, ...]) -> np.ndarray:
    """Return the (L, 3, 3) inverse covariances of marker positions in 1/m²: ``n nᵀ / s² + (I - n nᵀ) / t²``.

    n is the skin's normal. The standard deviations s (off the skin) and t (along it) depend on the location. Bone under
    thin skin can be palpated within a centimetre, but the middle of a thigh is not well defined. Raises the errors of
    ``marker_landmarks``.
    """
    normal = skin_normals(body, names)
    off, along = np.array([_spread(name) for name in names]).T
    outer = normal[:, :, None] * normal[:, None]
    return outer * (off**-2 - along**-2)[:, None, None] + np.eye(3) * (along**-2)[:, None, None]


def skin_normals(body: Body, names: tuple[str, ...]) -> np.ndarray:
    """Return the outward unit normals (L, 3) of the skin at markers on the resting body, or 0 for points inside it."""
    on, off = (
        LandmarkBuilder(body, _rules_of(names, distance)).build(names).anchors.sum(axis=1) for distance in (0.0, 1.0)
    )
    return off - on


def _spread(name: str) -> tuple[float, float]:
    if is_joint_centre(name):
        part = name.rpartition("_")[2]
        limb = part in _LIMB_JOINTS and (name[0] == JOINT or part != "hip")
        spread = LIMB_JOINT_SPREAD_M if limb else INNER_SPREAD_M
        return spread, spread
    return (ON_BONE_SPREAD_M, ON_BONE_SPREAD_M) if name.startswith(ON_BONE) else load_layouts().spread_of(name)


def _rules_of(names: tuple[str, ...], distance_m: float) -> dict[str, tuple[str, Rule]]:
    bones = {name: ("", AtJoints({name[len(ON_BONE) :]: 1.0})) for name in names if name.startswith(ON_BONE)}
    inside = {name: keypoint_rules()[name[1:]] for name in names if name.startswith(KEYPOINT)}
    joints = {name: ("", AtJoints({name[1:]: 1.0})) for name in names if name.startswith(JOINT)}
    # A rule may refer to other landmarks, as the mid-hip refers to both hips.
    return {**keypoint_rules(), **_rules(distance_m), **bones, **inside, **joints}


@cache
def _rules(distance_m: float) -> dict[str, tuple[str, OnSurface]]:
    file = load_layouts()
    rules = {name: ("", _rule(values, distance_m)) for name, values in file.midline.items()}
    for part, values in file.sided.items():
        for letter, side in (("L", "left"), ("R", "right")):
            rules[letter + part] = (side, _rule(values, distance_m))
    return rules | {alias: rules[name] for alias, name in file.aliases.items()}


def _rule(values: Mapping[str, Any], distance_m: float) -> OnSurface:
    return OnSurface(
        values["joint"],
        tuple(values["direction"]),
        tuple(values.get("start", (0.0, 0.0, 0.0))),
        -distance_m,
        values.get("towards", ""),
        values.get("along", 0.0),
    )
