"""The committed hands: fingers keep their thickness and hands their volume in every gesture, and sides mirror."""

from __future__ import annotations

import numpy as np
import pytest

from assets_procedural.mesh.charts import MATERIAL_NAMES
from assets_procedural.quality.contact_sheet import read_baked
from assets_procedural.quality.hand_sheet import HANDS, palm_faces, pose_hands
from assets_procedural.skeleton.skinning import volume
from solver_backend.body.body import DEFAULT_BODY
from solver_backend.body.hand_skeleton import ANGLES, JOINT_OF
from solver_backend.body.hands import hand_points, hand_skeletons, load_body_with_hands, rest_angles
from solver_backend.exchange.body_layout import SMPL_HANDS
from solver_backend.exchange.joint_sets import FINGERS, SIDES

LEFT = [SMPL_HANDS.joints.index("left_wrist"), *SMPL_HANDS.group("left_hand")]
BENDS = [name for name in ANGLES if name.endswith("flexion") and name != "thumb_cmc_flexion"]


@pytest.fixture(scope="module")
def body():
    return load_body_with_hands()


def hand_volume(body, skin):
    """Return the volume of the left hand, cubic metres, but for a part that no finger moves."""
    faces = body.faces[(body.weights[:, LEFT].sum(axis=1) > 0)[body.faces].all(axis=1)]
    return volume(skin - body.joints_template[LEFT[0]], faces)


@pytest.mark.parametrize("gesture", HANDS)
def test_a_hand_keeps_its_volume_in_every_gesture(body, gesture):
    at_rest = hand_volume(body, body.v_template)
    changed = hand_volume(body, pose_hands(body, HANDS[gesture])) / at_rest - 1.0
    assert abs(changed) < 0.02
    if gesture == "fist":
        assert hand_volume(body, pose_hands(body, HANDS[gesture], correctives=False)) / at_rest - 1.0 < -0.05


@pytest.mark.parametrize("bend", BENDS)
def test_a_bent_knuckle_is_as_thick_as_a_straight_one(body, bend):
    skin = pose_hands(body, {bend: 85.0})
    finger, joint = bend.split("_")[0], int(JOINT_OF[ANGLES.index(bend)])
    centre = body.joints_template[SMPL_HANDS.joints.index(f"left_{finger}{joint + 1}")]
    nearest = [np.linalg.norm(vertices - centre, axis=1).min() for vertices in (skin, body.v_template)]
    assert nearest[0] > 0.93 * nearest[1]


def test_a_bend_moves_its_own_finger_and_hardly_its_neighbours(body):
    skin, points = pose_hands(body, {"middle_mcp_flexion": 85.0, "middle_pip_flexion": 90.0}), hand_points(body, 0)
    moved = np.linalg.norm(skin - body.v_template, axis=1)
    for finger, first in (("index", 5), ("ring", 13), ("pinky", 17)):
        own = [SMPL_HANDS.joints.index(f"left_{finger}{k}") for k in (1, 2, 3)]
        bone = points[first + 1] - points[first]
        # The web between fingers reaches half way to the next joint.
        beyond = (body.v_template - points[first]) @ bone > 0.75 * bone @ bone
        beyond &= body.weights[:, own].sum(axis=1) > 0.5
        assert beyond.sum() > 30 and moved[beyond].max() < 0.002, finger


def test_the_right_hand_is_the_left_ones_mirror_image_in_a_fist(body):
    skin = pose_hands(body, HANDS["fist"])
    with np.load(DEFAULT_BODY) as data:
        mirror = data["mirror"].astype(int)
    np.testing.assert_allclose(skin[mirror] * [-1.0, 1.0, 1.0], skin, atol=2e-5)


@pytest.mark.parametrize("side", [0, 1])
@pytest.mark.parametrize("pose", HANDS)
def test_nails_stay_on_the_backs_of_fingers_and_the_palm_on_its_side(body, pose, side):
    skeleton, posed = hand_skeletons(body)[side], pose_hands(body, HANDS[pose])
    angles = rest_angles(body)[None].copy()
    for name, value in HANDS[pose].items():
        angles[..., ANGLES.index(name)] = np.radians(value)
    own = skeleton.pose(angles[:, side])
    a, b, c = (posed[body.faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    material = read_baked().material
    for finger in range(len(FINGERS)):
        last = SMPL_HANDS.joints.index(f"{SIDES[side]}_{FINGERS[finger]}3")
        nail = (material == MATERIAL_NAMES.index("nail")) & (body.weights[:, last][body.faces].min(axis=1) > 0.5)
        assert nail.sum() >= 4
        assert np.median(normals[nail] @ own.frames[0, finger, 3, :, 1]) > 0.8, FINGERS[finger]
    palm = palm_faces(body, side)
    assert palm.sum() >= 20 and np.median(normals[palm] @ skeleton.palm[2, :, 1]) < -0.8
