"""Keypoint regressors: what each detector means by its points, defined by anatomical rule on any body."""

from __future__ import annotations

import numpy as np

from solver_backend.body.anatomy import AtJoints, Between, LandmarkBuilder, OnSurface, Rule
from solver_backend.body.body import Body
from solver_backend.body.landmarks import Landmarks
from solver_backend.types import SMPL_JOINTS, JointSet

_MIDLINE: dict[str, Rule] = {
    "nose": OnSurface("head", (0, 0, 1), (0, 0.045, 0)),
    "neck": Between({"left_shoulder": 0.5, "right_shoulder": 0.5}),
    "upper_neck": AtJoints({"neck": 0.6, "head": 0.4}),
    "head_top": OnSurface("head", (0, 1, 0), (0, 0.05, 0.0)),
    "mid_hip": Between({"left_hip": 0.5, "right_hip": 0.5}),
    "spine": AtJoints({"spine2": 1.0}),
    "thorax": Between({"left_shoulder": 0.5, "right_shoulder": 0.5}),
}
_LEFT: dict[str, Rule] = {
    "eye": OnSurface("head", (0, 0, 1), (0.032, 0.08, 0), depth=0.008),
    "eye_inner": OnSurface("head", (0, 0, 1), (0.02, 0.08, 0), depth=0.004),
    "eye_outer": OnSurface("head", (0, 0, 1), (0.044, 0.08, 0), depth=0.004),
    "mouth": OnSurface("head", (0, 0, 1), (0.02, 0.012, 0)),
    "ear": OnSurface("head", (1, 0, 0), (0, 0.06, 0.0), depth=0.005),
    "shoulder": AtJoints({"shoulder": 1.0}),
    "elbow": AtJoints({"elbow": 1.0}),
    "wrist": AtJoints({"wrist": 1.0}),
    "hip": AtJoints({"hip": 1.0}),
    "knee": AtJoints({"knee": 1.0}),
    "ankle": AtJoints({"ankle": 1.0}),
    "big_toe": OnSurface("foot", (-0.12, 0, 1), (0, -0.004, 0), depth=0.008),
    "small_toe": OnSurface("foot", (0.55, 0, 1), (0, -0.006, 0), depth=0.008),
    "heel": OnSurface("ankle", (0, 0, -1), (0, -0.045, 0), depth=0.008),
    "thumb": AtJoints({"hand": 1.0}, (-0.02, 0, 0.045)),
    "index": AtJoints({"hand": 1.0}, (0.015, 0, 0.02)),
    "pinky": AtJoints({"hand": 1.0}, (0.0, 0, -0.035)),
}


def keypoint_landmarks(body: Body, joint_set: JointSet) -> Landmarks:
    """Return the landmarks that a detector's keypoints are on this body.

    Raises:
        BodyInvalid: a ray misses the mesh, so the body is not a closed T-posed mesh in SMPL's frame.
    """
    if joint_set is JointSet.SMPL_24:
        chosen = list(body.smpl_joints)
        one_hot = np.eye(len(body.parents))[chosen]
        joints, directions = body.joints_template[chosen], body.joints_shapedirs[chosen]
        return Landmarks.of_points(SMPL_JOINTS, joints, directions, one_hot)
    return LandmarkBuilder(body, _RULES).build(joint_set.keypoints)


def _sided_rules() -> dict[str, tuple[str, Rule]]:
    """Return side and rule of every keypoint name."""
    rules: dict[str, tuple[str, Rule]] = {name: ("", rule) for name, rule in _MIDLINE.items()}
    for part, rule in _LEFT.items():
        for side in ("left", "right"):
            rules[f"mouth_{side}" if part == "mouth" else f"{side}_{part}"] = (side, rule)
    return rules


_RULES = _sided_rules()
