"""A body stands in its own way, as seen from behind and from the side."""

from __future__ import annotations

import numpy as np

from research.simulation.occlusion import self_occluded
from solver_backend.body.body import load_body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.body.landmarks import pose_landmarks
from solver_backend.body.mesh import pose_mesh
from solver_backend.synthesis.simulation.keypoint_detector import own_faces, stabbed_faces
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
    skin = pose_mesh(body, np.zeros(10), eye[None], np.tile(eye, (1, 21, 1, 1)), np.zeros((1, 3)))
    cameras = _cameras((0, 0, 1), (0, 0, -1), (1, 0, 0))
    return self_occluded(cameras, body, skin, posed.points, NAMES)[:, 0]


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


def test_only_faces_before_the_target_and_across_its_sight_line_are_stabbed() -> None:
    triangle = np.array([[-1.0, -1.0, 2.0], [0.0, 1.0, 2.0], [1.0, -1.0, 2.0]])
    skin = np.concatenate([triangle, triangle * 2, triangle + [3.0, 0.0, 0.0], triangle[::-1]])
    targets = np.array([[0.0, 0.0, 3.0], [0.0, 0.0, 5.0], [0.0, 0.0, 2.02], [0.0, 2.0, 3.0]])
    face, target = stabbed_faces(skin, np.arange(12).reshape(4, 3), targets)
    assert set(zip(face.tolist(), target.tolist(), strict=True)) == {(0, 0), (0, 1), (1, 1)}


def test_a_slanted_face_is_as_deep_as_its_plane() -> None:
    skin = np.array([[-1.0, -1.0, 1.0], [0.0, 9.0, 3.0], [4.0, -4.0, 4.0]])
    normal = np.cross(skin[1] - skin[0], skin[2] - skin[0])
    direction = np.array([0.1, 0.2, 1.0])
    depth, length = (normal @ skin[0]) / (normal @ direction), np.linalg.norm(direction)
    for beyond, expected in ((0.03, 0), (0.04, 1)):
        face, _ = stabbed_faces(skin, np.array([[0, 1, 2]]), (direction * (depth + beyond / length))[None])
        assert len(face) == expected


def test_a_keypoint_belongs_to_the_parts_around_it() -> None:
    body = load_body()
    own = dict(zip(NAMES, own_faces(body, NAMES), strict=True))
    centre = body.v_template[body.faces].mean(axis=1)
    assert (centre[own["left_wrist"], 0] > 0.2).all() and (centre[own["right_wrist"], 0] < -0.2).all()
    assert own["left_knee"].any() and not (own["left_knee"] & own["right_knee"]).any()
    assert not own["nose"].any()
