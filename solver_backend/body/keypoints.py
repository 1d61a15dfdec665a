"""Define each detector's keypoints on any body by anatomical rules.

Detectors reproduce the points that annotators clicked, which are not joint centres. The offsets come from:

- COCO's hips are outside and above the joint centres, its ankles above them. BODY_25B's upper neck is near the centre
  of neck rotation, and its big toe is short of the tip. Measured by triangulating BODY_25B in Pose2Sim's recording with
  four calibrated cameras (one person with a trunk as long as the body's): hips 205 mm apart (joint centres 160), thigh
  424 (396), shank 382 (404), heel to big toe 209 (241), upper neck 57 above the shoulders (94).
- OpenPose's neck and mid-hip are midpoints of left and right keypoints (its authors, openpose issue 1537).
- Human3.6M's skeleton as published with Martinez et al. 2017 (``forward_kinematics.py``), in mm: hips 133 from the
  midline, thigh 443, shank 454, spine 233 above the hips, thorax 257 above that, shoulders 151 from the midline, upper
  arm 279, forearm 252, nose 121 above the thorax, and a "head" 115 above that, which is the forehead. Its legs are a
  tenth longer than the body's, so its person is taller. Hip breadth, spine, nose and head are defined here.
- MediaPipe's hand points are the first knuckles of little and index finger and the thumb's second (BlazePose GHUM).

The solver estimates the remaining difference between detector and person in each take, as an offset per landmark.
"""

from __future__ import annotations

import numpy as np

from solver_backend.body.anatomy import AtJoints, Between, LandmarkBuilder, OnSurface, Rule
from solver_backend.body.body import Body
from solver_backend.body.landmarks import Landmarks
from solver_backend.exchange.body_layout import SMPL, BodyLayout
from solver_backend.types import JointSet

_MIDLINE: dict[str, Rule] = {
    "nose": OnSurface("head", (0, 0, 1), (0, 0.045, 0)),
    "neck": Between({"left_shoulder": 0.5, "right_shoulder": 0.5}),
    "thorax": Between({"left_shoulder": 0.5, "right_shoulder": 0.5}),
    "upper_neck": AtJoints({"neck": 1.0}),
    "head_top": OnSurface("head", (0, 1, 0), (0, 0.05, 0.0)),
    "mid_hip": Between({"left_hip": 0.5, "right_hip": 0.5}),
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
    "hip": AtJoints({"hip": 1.0}, (0.022, 0.02, 0.0)),
    "knee": AtJoints({"knee": 1.0}),
    "ankle": AtJoints({"ankle": 1.0}, (0.0, 0.015, 0.0)),
    "big_toe": OnSurface("foot", (-0.2, 0, 1), (0, -0.004, 0), depth=0.02),  # next to the nail, where triangles tilt
    "small_toe": OnSurface("foot", (1, 0, 0.75), (0, -0.006, 0), depth=0.008),
    "heel": OnSurface("ankle", (0, 0, -1), (0, -0.05, 0), depth=0.008),
    "thumb": AtJoints({"hand": 1.0}, (-0.02, 0, 0.045), finger="thumb2"),
    "index": AtJoints({"hand": 1.0}, (0.015, 0, 0.02), finger="index1"),
    "pinky": AtJoints({"hand": 1.0}, (0.0, 0, -0.035), finger="pinky1"),
}
_OWN: dict[JointSet, tuple[dict[str, Rule], dict[str, Rule]]] = {
    JointSet.H36M_17: (
        {
            "spine": AtJoints({"spine1": 0.7, "spine2": 0.3}),
            "nose": AtJoints({"head": 1.0}, (0.0, -0.012, 0.03)),
            "head_top": AtJoints({"head": 1.0}, (0.0, 0.1, 0.02)),
        },
        {"hip": AtJoints({"hip": 1.0}, (0.045, 0.0, 0.0)), "ankle": AtJoints({"ankle": 1.0})},
    ),
}
"""Midline and left rules of joint sets in which a name means another location."""


def keypoint_landmarks(body: Body, joint_set: JointSet) -> Landmarks:
    """Return keypoints as landmarks on a body. Raise ``BodyInvalid`` if a ray misses the skin."""
    if joint_set is JointSet.SMPL_24:
        return joint_landmarks(body, SMPL)
    return LandmarkBuilder(body, _RULES.get(joint_set, _COMMON)).build(joint_set.keypoints)


def keypoint_rules() -> dict[str, tuple[str, Rule]]:
    """Return the side and the landmark rule of each keypoint, for detectors without rules of their own."""
    return _COMMON


def joint_landmarks(body: Body, layout: BodyLayout) -> Landmarks:
    """Return a layout's joints as landmarks on a body. Raise ``BodyInvalid`` if the body lacks one of them."""
    chosen = list(body.layout.standing_for(layout))
    one_hot = np.eye(body.layout.num_joints)[chosen]
    joints, directions = body.joints_template[chosen], body.joints_shapedirs[chosen]
    return Landmarks.of_points(layout.joints, joints, directions, one_hot)


def _sided_rules(midline: dict[str, Rule], left: dict[str, Rule]) -> dict[str, tuple[str, Rule]]:
    rules: dict[str, tuple[str, Rule]] = {name: ("", rule) for name, rule in midline.items()}
    for part, rule in left.items():
        for side in ("left", "right"):
            rules[f"mouth_{side}" if part == "mouth" else f"{side}_{part}"] = (side, rule)
    return rules


_COMMON = _sided_rules(_MIDLINE, _LEFT)
_RULES = {chosen: _sided_rules(_MIDLINE | middle, _LEFT | left) for chosen, (middle, left) in _OWN.items()}
