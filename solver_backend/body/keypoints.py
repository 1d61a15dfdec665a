"""Keypoint regressors: what each detector means by its points, defined by anatomical rule on any body."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from solver_backend.body.body import Body
from solver_backend.body.landmarks import Landmarks
from solver_backend.body.raycast import cast_ray
from solver_backend.types import SMPL_JOINTS, JointSet


@dataclass(frozen=True)
class AtJoints:
    """The weighted mean of joints, moved by an offset carried by ``bone`` (lengths for a stature of 1.70 m)."""

    joints: dict[str, float]
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class OnSurface:
    """Where a ray from a joint (moved by ``start``) leaves the skin, then ``depth`` metres inwards."""

    joint: str
    direction: tuple[float, float, float]
    start: tuple[float, float, float] = (0.0, 0.0, 0.0)
    depth: float = 0.0


@dataclass(frozen=True)
class Between:
    """The weighted mean of other keypoints."""

    keypoints: dict[str, float] = field(default_factory=dict)


Rule = AtJoints | OnSurface | Between

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
        return _joint_landmarks(body)
    return _Builder(body).build(joint_set.keypoints)


def _joint_landmarks(body: Body) -> Landmarks:
    eye = np.eye(len(SMPL_JOINTS))
    return Landmarks(SMPL_JOINTS, body.joints_template, body.joints_shapedirs, eye, eye)


class _Builder:
    """Collects skinned points and mixes them into keypoints."""

    def __init__(self, body: Body) -> None:
        self._body, self._scale = body, body.stature_m / 1.70
        self._rest: list[np.ndarray] = []
        self._shapedirs: list[np.ndarray] = []
        self._weights: list[np.ndarray] = []

    def build(self, names: tuple[str, ...]) -> Landmarks:
        mixes = [self._keypoint(name) for name in names]
        mix = np.zeros((len(names), len(self._rest)))
        for row, shares in enumerate(mixes):
            for point, share in shares.items():
                mix[row, point] += share
        return Landmarks(names, np.stack(self._rest), np.stack(self._shapedirs), np.stack(self._weights), mix)

    def _keypoint(self, name: str) -> dict[int, float]:
        side, rule = _rule(name)
        if isinstance(rule, Between):
            shares: dict[int, float] = {}
            for other, share in rule.keypoints.items():
                for point, part in self._keypoint(other).items():
                    shares[point] = shares.get(point, 0.0) + share * part
            return shares
        if isinstance(rule, AtJoints):
            return self._at_joints(rule, side)
        return {self._on_surface(rule, side): 1.0}

    def _at_joints(self, rule: AtJoints, side: str) -> dict[int, float]:
        shares = {}
        for joint, share in rule.joints.items():
            j = _joint_index(joint, side)
            rest = self._body.joints_template[j] + self._vector(rule.offset, side)
            shares[self._add(rest, self._body.joints_shapedirs[j], np.eye(len(SMPL_JOINTS))[j])] = share
        return shares

    def _on_surface(self, rule: OnSurface, side: str) -> int:
        start = self._body.joints_template[_joint_index(rule.joint, side)] + self._vector(rule.start, side)
        direction = self._vector(rule.direction, side)
        hit = cast_ray(self._body, start, direction)
        rest = hit.barycentric @ self._body.v_template[hit.vertices]
        rest = rest - rule.depth * self._scale * direction / np.linalg.norm(direction)
        shapedirs = np.tensordot(hit.barycentric, self._body.shapedirs[hit.vertices], axes=1)
        return self._add(rest, shapedirs, hit.barycentric @ self._body.weights[hit.vertices])

    def _add(self, rest: np.ndarray, shapedirs: np.ndarray, weights: np.ndarray) -> int:
        self._rest.append(rest)
        self._shapedirs.append(shapedirs)
        self._weights.append(weights)
        return len(self._rest) - 1

    def _vector(self, value: tuple[float, float, float], side: str) -> np.ndarray:
        return np.array(value, dtype=np.float64) * self._scale * ([-1, 1, 1] if side == "right" else [1, 1, 1])


def _rule(name: str) -> tuple[str, Rule]:
    """Return the side ('left', 'right' or '') and the rule of a keypoint."""
    if name in _MIDLINE:
        return "", _MIDLINE[name]
    if name in ("mouth_left", "mouth_right"):
        return name[6:], _LEFT["mouth"]
    side, _, part = name.partition("_")
    return side, _LEFT[part]


def _joint_index(joint: str, side: str) -> int:
    return SMPL_JOINTS.index(joint if joint in SMPL_JOINTS else f"{side}_{joint}")
