"""Bodies whose fingers move: the skin at rest stays, fingers bend to the palm, sides mirror, SMPL-X loses its face."""

from __future__ import annotations

import numpy as np
import pytest

from solver_backend.body.body import DEFAULT_BODY, load_body
from solver_backend.body.files.choices import load_smpl_file
from solver_backend.body.hand_skeleton import ANGLES, measure_angles
from solver_backend.body.hands import (
    FIRST_FINGER,
    finger_rotations,
    hand_points,
    load_body_with_hands,
    rest_angles,
    tip_vertices,
    with_fingers,
    with_hand_size,
)
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.body.landmarks import pose_landmarks
from solver_backend.body.mesh import pose_mesh
from solver_backend.exchange.body_layout import SMPL, SMPL_HANDS
from solver_backend.exchange.errors import BodyInvalid
from solver_backend.exchange.joint_sets import FINGERS, HAND_POINTS, SIDES
from solver_backend.geometry.rotations import exp_so3
from solver_backend.types import JointSet
from tests.body.oracle import model, state
from tests.support.stick_body import stick_body

FLIP = np.array([-1.0, 1.0, 1.0])


@pytest.fixture(scope="module")
def hands():
    return load_body_with_hands()


def posed(hands, **degrees):
    """Return (1, 51, 3, 3) rotations with these kinds of angles of both hands added to those at rest."""
    angles = rest_angles(hands)[None].copy()
    for kind, value in degrees.items():
        angles[:, :, [kind in name and "thumb" not in name for name in ANGLES]] += np.radians(value)
    body = np.tile(np.eye(3), (1, SMPL.num_solved, 1, 1))
    return np.concatenate([body, finger_rotations(hands, angles)], axis=1)


def skin_of(hands, local):
    return pose_mesh(hands, np.zeros(10), np.eye(3)[None], local, np.zeros((1, 3)))[0]


def test_without_turned_fingers_the_skin_is_that_of_the_body_without_finger_joints(hands):
    plain, rng = load_body(), np.random.default_rng(0)
    betas, local = rng.normal(size=10), exp_so3(0.5 * rng.normal(size=(3, SMPL.num_solved, 3)))
    args = (betas, exp_so3(rng.normal(size=(3, 3))), local, rng.normal(size=(3, 3)))
    np.testing.assert_allclose(pose_mesh(hands, *args), pose_mesh(plain, *args), atol=1e-6)
    whole = (*args[:2], np.concatenate([local, np.tile(np.eye(3), (3, 30, 1, 1))], axis=1), args[3])
    np.testing.assert_allclose(pose_mesh(hands, *whole), pose_mesh(plain, *args), atol=1e-6)
    joints = [forward_kinematics(body, *args).joints[:, :FIRST_FINGER] for body in (hands, plain)]
    np.testing.assert_allclose(*joints, atol=1e-9)
    assert hands.layout == SMPL_HANDS and hands.layout.recorded == SMPL_HANDS and hands.layout.num_solved == 51


def test_every_vertex_of_a_finger_is_carried_by_few_bones_of_its_own_hand(hands):
    assert np.count_nonzero(hands.weights, axis=1).max() <= 6
    left, right = (hands.weights[:, list(SMPL_HANDS.group(f"{side}_hand"))].sum(axis=1) for side in ("left", "right"))
    assert not ((left > 0) & (right > 0)).any() and (left > 0.99).sum() > 400
    assert (hands.v_template[left > 0, 0] > 0).all()
    with np.load(DEFAULT_BODY) as data:
        mirror = data["mirror"].astype(int)
    np.testing.assert_allclose(hands.weights[mirror][:, list(SMPL_HANDS.mirror)], hands.weights, atol=1e-7)


@pytest.mark.parametrize("beta", [-2.0, 0.0, 2.0])
def test_finger_joints_lie_inside_the_skin_of_small_and_large_people(hands, beta):
    betas = beta * np.eye(10)[0]
    skin, joints = hands.v_template + hands.shapedirs @ betas, hands.rest_joints(betas)[FIRST_FINGER:]
    corners = skin[hands.faces] - joints[:, None, None]
    lengths = np.linalg.norm(corners, axis=-1)
    a, b, c = np.moveaxis(corners, 2, 0)
    volume = np.einsum("...a,...a->...", a, np.cross(b, c))
    cosines = [np.einsum("...a,...a->...", x, y) for x, y in ((a, b), (b, c), (c, a))]
    la, lb, lc = np.moveaxis(lengths, 2, 0)
    # Solid angles of triangles (Van Oosterom, Strackee 1983) sum to 4 pi inside a closed mesh, to 0 outside.
    around = 2 * np.arctan2(volume, la * lb * lc + cosines[0] * lc + cosines[1] * la + cosines[2] * lb).sum(axis=1)
    np.testing.assert_allclose(around, 4 * np.pi, atol=1e-3)
    nearest = np.linalg.norm(skin - joints[:, None], axis=-1).min(axis=1)
    assert nearest.min() > 0.003 and nearest.max() < 0.02


def test_flexion_brings_fingertips_to_the_palm_and_spread_towards_the_thumb(hands):
    fist, spread = skin_of(hands, posed(hands, flexion=55)), skin_of(hands, posed(hands, mcp_spread=12))
    for side in range(2):
        points, tips = hand_points(hands, side), tip_vertices(hands)[side]
        middle, at_rest = points[HAND_POINTS.index("middle_mcp")], hands.v_template[tips]
        closer = np.linalg.norm(at_rest - middle, axis=1) - np.linalg.norm(fist[tips] - middle, axis=1)
        assert closer[1:].min() > 0.01
        assert ((spread[tips] - at_rest)[1:] @ (points[5] - points[17])).min() > 0.005 * 0.05
    np.testing.assert_allclose(fist[tip_vertices(hands)[1]], fist[tip_vertices(hands)[0]] * FLIP, atol=1e-6)


def test_rest_is_a_hand_that_is_slightly_bent_at_every_joint(hands):
    angles = dict(zip(ANGLES, np.degrees(rest_angles(hands).T), strict=True))
    for name, values in angles.items():
        assert values[0] == pytest.approx(values[1], abs=1e-3)
        assert not name.endswith(("mcp_flexion", "pip_flexion")) or 5 < values[0] < 50, name
    np.testing.assert_allclose(posed(hands), np.tile(np.eye(3), (1, 51, 1, 1)), atol=1e-6)


def test_larger_hands_grow_from_the_wrist(hands):
    large = with_hand_size(hands, 1.1)
    wrist, middle = (SMPL_HANDS.joints.index(name) for name in ("left_wrist", "left_middle1"))
    grown = large.joints_template - hands.joints_template
    np.testing.assert_allclose(
        grown[middle], 0.1 * (hands.joints_template[middle] - hands.joints_template[wrist]), atol=2e-5
    )
    assert np.abs(grown[:FIRST_FINGER]).max() < 2e-4
    tips = tip_vertices(hands).ravel()
    lengths = [
        np.linalg.norm(body.v_template[tips] - body.joints_template[[20] * 5 + [21] * 5], axis=1)
        for body in (large, hands)
    ]
    np.testing.assert_allclose(lengths[0] / lengths[1], 1.1, atol=2e-3)
    with pytest.raises(BodyInvalid, match=r"relative hand size is -1\.0"):
        with_hand_size(hands, -1.0)


@pytest.mark.parametrize("family", ["SMPL-H", "SMPL-X"])
def test_files_with_fingers_move_them_and_rest_the_face(family, tmp_path):
    np.savez(tmp_path / "model.npz", **model(family))
    body, given = load_smpl_file(tmp_path / "model.npz", family=family), state(family)
    own = body.layout.joints
    vectors = given["rotvec"].copy()
    vectors[:, list(body.layout.group("face"))] = 0.0
    root, transl = exp_so3(vectors[:, 0]), given["transl"]
    expected = pose_mesh(body, given["betas"], root, exp_so3(vectors[:, 1:]), transl)
    chosen = [own.index(name) for name in SMPL_HANDS.joints]
    moving = with_fingers(body)
    found = pose_mesh(moving, given["betas"], root, exp_so3(vectors[:, chosen[1:]]), transl)
    np.testing.assert_allclose(found, expected, atol=1e-9)
    assert moving.layout.joints == SMPL_HANDS.joints and moving.layout.num_solved == 51


def test_a_detectors_knuckles_are_joints_where_fingers_move(hands):
    names = JointSet.MEDIAPIPE_33.keypoints
    found, plain = (keypoint_landmarks(body, JointSet.MEDIAPIPE_33) for body in (hands, load_body()))
    curled = posed(hands, flexion=60)
    args = (np.zeros(10), np.eye(3)[None], curled, np.zeros((1, 3)))
    points = pose_landmarks(hands, found, *args).points[0]
    at_rest = pose_landmarks(load_body(), plain, *args[:2], curled[:, :21], args[3]).points[0]
    for keypoint, joint in (("index", "index1"), ("pinky", "pinky1"), ("thumb", "thumb2")):
        place = names.index(f"left_{keypoint}")
        expected = forward_kinematics(hands, *args).joints[0, SMPL_HANDS.joints.index(f"left_{joint}")]
        np.testing.assert_allclose(points[place], expected, atol=1e-9)
        assert np.linalg.norm(points[place] - at_rest[place]) < 0.04
    elsewhere = [i for i, name in enumerate(names) if not name.endswith(("index", "pinky", "thumb"))]
    np.testing.assert_allclose(points[elsewhere], at_rest[elsewhere], atol=1e-6)


def test_a_body_without_fingers_is_refused():
    with pytest.raises(BodyInvalid, match="has no finger joints"):
        with_fingers(stick_body())


def test_angles_of_a_posed_hand_are_those_that_posed_it(hands):
    rng = np.random.default_rng(5)
    angles = rest_angles(hands)[None] + 0.25 * rng.normal(size=(4, 2, len(ANGLES)))
    angles[:, :, ANGLES.index("thumb_cmc_twist")] = 0.0
    local = np.concatenate([np.tile(np.eye(3), (4, 21, 1, 1)), finger_rotations(hands, angles)], axis=1)
    still = (np.zeros(10), np.tile(np.eye(3), (4, 1, 1)), local, np.zeros((4, 3)))
    for side in range(2):
        joints, skin = forward_kinematics(hands, *still).joints, pose_mesh(hands, *still, correctives=False)
        named = [[f"{SIDES[side]}_{finger}{k}" for k in (1, 2, 3)] for finger in FINGERS]
        chains = joints[:, [[SMPL_HANDS.joints.index(name) for name in names] for names in named]]
        ends = skin[:, tip_vertices(hands)[side], None]
        wrist = joints[:, None, SMPL_HANDS.joints.index(f"{SIDES[side]}_wrist")]
        points = np.concatenate([wrist, np.concatenate([chains, ends], axis=2).reshape(4, 20, 3)], axis=1)
        of_joints = [i for i, name in enumerate(ANGLES) if not name.endswith(("dip_flexion", "ip_flexion"))]
        np.testing.assert_allclose(measure_angles(points, side)[:, of_joints], angles[:, side][:, of_joints], atol=1e-3)
