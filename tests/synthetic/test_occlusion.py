"""A body stands in its own way, as seen from behind and from the side."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from solver_backend.body.body import load_body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.body.landmarks import pose_landmarks
from solver_backend.synthetic.occlusion import segment_distance, self_occluded
from solver_backend.types import Cameras, JointSet

NAMES = JointSet.BODY_25.keypoints


def _cameras(*directions: tuple[float, float, float]) -> Cameras:
    """Cameras five metres from (0, 0, 0), level, in the body's Y-up frame."""
    forward = -np.array(directions)
    right = np.cross(forward, [0.0, 1.0, 0.0])
    R = np.stack([right, np.cross(forward, right), forward], axis=1)
    t = -np.einsum("cij,cj->ci", R, 5.0 * np.array(directions))
    K = np.tile([[1000.0, 0, 960], [0, 1000, 540], [0, 0, 1]], (len(directions), 1, 1))
    names = tuple(str(i) for i in range(len(directions)))
    return Cameras(names, K, np.zeros((len(directions), 8)), R, t, np.tile([1920, 1080], (len(directions), 1)))


def _hidden_in_t_pose() -> np.ndarray:
    body = load_body()
    eye = np.eye(3)
    posed = pose_landmarks(
        body, keypoint_landmarks(body, JointSet.BODY_25), np.zeros(10), eye[None], np.tile(eye, (1, 21, 1, 1)),
        np.zeros((1, 3)),
    )  # fmt: skip
    cameras = _cameras((0, 0, 1), (0, 0, -1), (1, 0, 0))
    return self_occluded(cameras, posed.skeleton.joints, posed.points, NAMES)[:, 0]


def test_nothing_of_a_t_pose_is_hidden_from_the_front() -> None:
    hidden = _hidden_in_t_pose()[0]
    assert [name for name, h in zip(NAMES, hidden, strict=True) if h] == []


def test_the_head_hides_the_face_from_behind_and_nothing_of_the_limbs() -> None:
    hidden = {name for name, h in zip(NAMES, _hidden_in_t_pose()[1], strict=True) if h}
    assert {"nose", "left_eye", "right_eye"} <= hidden
    assert not any("wrist" in name or "knee" in name or "elbow" in name for name in hidden)


def test_from_the_left_the_right_side_is_hidden_and_the_left_is_seen() -> None:
    hidden = {name for name, h in zip(NAMES, _hidden_in_t_pose()[2], strict=True) if h}
    assert {"right_knee", "right_ankle", "right_wrist", "right_elbow", "right_ear"} <= hidden
    # The left arm points at the camera and hides itself; all else on this side is in sight.
    seen = ("hip", "knee", "ankle", "big_toe", "small_toe", "heel", "ear", "eye")
    assert not hidden & {f"left_{part}" for part in seen}


@given(st.integers(0, 10_000))
def test_segment_distance_is_the_least_over_a_grid(seed: int) -> None:
    p, q, a, b = np.random.default_rng(seed).normal(size=(4, 3))
    s, t = np.meshgrid(np.linspace(0, 1, 201), np.linspace(0, 1, 201))
    grid = np.linalg.norm(p + s[..., None] * (q - p) - a - t[..., None] * (b - a), axis=-1).min()
    exact = float(segment_distance(p, q, a, b))
    assert grid - 0.03 <= exact <= grid + 1e-12


def test_segment_distance_of_a_point_and_of_parallels() -> None:
    p, q = np.zeros(3), np.array([1.0, 0, 0])
    assert segment_distance(p, q, np.array([2.0, 1, 0]), np.array([2.0, 1, 0])) == np.sqrt(2)
    assert segment_distance(p, q, np.array([0.0, 2, 0]), np.array([1.0, 2, 0])) == 2.0
