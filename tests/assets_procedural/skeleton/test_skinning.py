"""Weights, blending and correctives."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from assets_procedural.build import BODY_FILE
from assets_procedural.layout import MIRROR_JOINT, PARENTS
from assets_procedural.quality.contact_sheet import BakedBody, read_baked
from assets_procedural.skeleton.correctives import (
    dual_quaternion_blend,
    joint_masks,
    pose_features,
    rest_differences,
    sample_poses,
)
from assets_procedural.skeleton.skinning import cotangent_laplacian, linear_blend, pose_skeleton, vertex_areas

FLIP = np.array([-1.0, 1.0, 1.0])


@pytest.fixture(scope="module")
def body() -> BakedBody:
    return read_baked()


def test_dual_quaternions_and_linear_blending_agree_on_one_bone(body: BakedBody) -> None:
    weights = np.eye(24)[np.random.default_rng(0).integers(0, 24, len(body.vertices))]
    turns, shifts = pose_skeleton(body.joints, sample_poses(1, seed=3)[0])
    linear = linear_blend(body.vertices, weights, turns, shifts)
    np.testing.assert_allclose(dual_quaternion_blend(body.vertices, weights, turns, shifts), linear, atol=1e-12)


def test_dual_quaternion_twist_keeps_the_radius() -> None:
    joints = np.zeros((24, 3))
    local = np.tile(np.eye(3), (24, 1, 1))
    local[20] = Rotation.from_rotvec([np.pi / 2, 0, 0]).as_matrix()
    weights = np.zeros((1, 24))
    weights[0, [18, 20]] = 0.5
    turns, shifts = pose_skeleton(joints, local)
    point = np.array([[0.0, 0.03, 0.0]])
    assert np.linalg.norm(dual_quaternion_blend(point, weights, turns, shifts)) == pytest.approx(0.03)
    assert np.linalg.norm(linear_blend(point, weights, turns, shifts)) == pytest.approx(0.03 / np.sqrt(2))


def test_rest_differences_lead_linear_blending_to_dual_quaternions(body: BakedBody) -> None:
    local = sample_poses(1, seed=5)
    local[0] = Rotation.from_rotvec(0.4 * Rotation.from_matrix(local[0]).as_rotvec()).as_matrix()
    offset = rest_differences(body.vertices, body.weights, body.joints, local)[0]
    turns, shifts = pose_skeleton(body.joints, local[0])
    wanted = dual_quaternion_blend(body.vertices, body.weights, turns, shifts)
    before = np.linalg.norm(linear_blend(body.vertices, body.weights, turns, shifts) - wanted, axis=1)
    after = np.linalg.norm(linear_blend(body.vertices + offset, body.weights, turns, shifts) - wanted, axis=1)
    assert after.mean() < 0.1 * before.mean()


def test_mirrored_pose_gives_the_mirrored_body(body: BakedBody) -> None:
    local = sample_poses(1, seed=7)[0]
    mirrored = (local * FLIP[:, None] * FLIP)[list(MIRROR_JOINT)]
    with np.load(BODY_FILE) as data:
        mirror = data["mirror"]
    np.testing.assert_allclose(body.posed(mirrored), body.posed(local)[mirror] * FLIP, atol=2e-5)


def test_masks_vanish_on_rigid_skin(body: BakedBody) -> None:
    masks = joint_masks(np.eye(24))
    assert not masks.any()
    halves = np.zeros((1, 24))
    halves[0, [4, 7]] = 0.5
    assert joint_masks(halves)[0, 6] == 1.0 and joint_masks(halves).sum() == 1.0


def test_pose_features_are_row_major_and_vanish_at_rest() -> None:
    assert not pose_features(np.tile(np.eye(3), (1, 24, 1, 1))).any()
    local = np.tile(np.eye(3), (1, 24, 1, 1))
    local[0, 1, 0, 2] = 5.0
    assert pose_features(local)[0, 2] == 5.0


def test_laplacian_annihilates_constants_and_areas_add_up(body: BakedBody) -> None:
    laplacian, area = cotangent_laplacian(body.vertices, body.faces)
    np.testing.assert_allclose(laplacian @ np.ones(len(area)), 0.0, atol=1e-9)
    np.testing.assert_allclose(area, vertex_areas(body.vertices, body.faces))
    assert 1.6 < area.sum() < 2.2


def test_children_follow_their_parents() -> None:
    joints = np.random.default_rng(1).normal(size=(24, 3))
    local = sample_poses(1, seed=2)[0]
    turns, shifts = pose_skeleton(joints, local)
    for child, parent in enumerate(PARENTS):
        if parent >= 0:
            by_parent = turns[parent] @ joints[child] + shifts[parent]
            np.testing.assert_allclose(turns[child] @ joints[child] + shifts[child], by_parent, atol=1e-12)
