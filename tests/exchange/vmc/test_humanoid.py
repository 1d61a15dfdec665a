"""Bundles put an avatar where the motion has the body, as a receiver reads them that knows the specification alone."""

from __future__ import annotations

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.body.hands import load_body_with_hands
from solver_backend.exchange.body_layout import SMPL, SMPL_H, BodyLayout
from solver_backend.exchange.errors import MotionInvalid
from solver_backend.exchange.so3 import matrix_from_quat, matrix_from_rotvec, quat_from_rotvec
from solver_backend.exchange.vmc.humanoid import BONE_OF, Humanoid, t_pose
from solver_backend.exchange.vmc.osc import FrameBundle
from tests.support.vmc_receiver import Avatar, messages_of

FLIP = np.diag([-1.0, 1.0, 1.0])
Y_UP = np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]])
BETAS = np.linspace(-2.0, 2.0, 10)


def with_fingers(rest: np.ndarray) -> np.ndarray:
    """Return SMPL-H's joints: SMPL's, and finger bones of 3 cm that point along the arm and fan out."""
    joints = np.zeros((SMPL_H.num_joints, 3))
    joints[:22] = rest[:22]
    for j in range(22, SMPL_H.num_joints):
        parent, first = SMPL_H.parents[j], SMPL_H.joints[j].endswith("1")
        side, fan = (1.0 if SMPL_H.joints[j].startswith("left") else -1.0), ((j - 22) // 3 % 5 - 2) * 0.02
        joints[j] = joints[parent] + (side * (0.09 if first else 0.03), -0.002, fan if first else 0.1 * fan)
    return joints


@pytest.fixture(params=["SMPL", "SMPL-H", "ours with hands"])
def humanoid(request) -> Humanoid:
    if request.param == "ours with hands":
        body = load_body_with_hands()
        return Humanoid(body.layout, body.rest_joints(BETAS))
    rest = load_body().rest_joints(BETAS)
    return Humanoid(SMPL, rest) if request.param == "SMPL" else Humanoid(SMPL_H, with_fingers(rest))


def posed(humanoid: Humanoid, rotvec: np.ndarray, transl: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the global rotations and places of all joints in our world, joint by joint."""
    rest, R = humanoid.rest_joints, matrix_from_rotvec(rotvec)
    G, places = [R[0]], [rest[0] + transl]
    for j in range(1, humanoid.layout.num_joints):
        p = humanoid.layout.parents[j]
        G.append(G[p] @ R[j])
        places.append(places[p] + G[p] @ (rest[j] - rest[p]))
    return np.stack(G), np.stack(places)


def angle_deg(A: np.ndarray, B: np.ndarray) -> float:
    return float(np.degrees(2 * np.arcsin(min(np.linalg.norm(A - B) / 8**0.5, 1.0))))


def test_an_avatar_of_our_proportions_stands_where_the_body_does(humanoid):
    rng, bundle = np.random.default_rng(0), FrameBundle(humanoid)
    turns = matrix_from_quat(t_pose(humanoid.layout, humanoid.rest_joints))
    for number in range(20):
        rotvec = rng.normal(0, 1.0, (humanoid.layout.num_joints, 3))
        transl = rng.normal(0, 3.0, 3)
        if humanoid.layout is SMPL:
            rotvec[22:] = 0  # knuckles are no bones
        avatar = Avatar().receive(bundle.encode(number / 60.0, rotvec, transl))
        assert avatar.available == 1 and avatar.time == pytest.approx(number / 60.0)
        G, places = posed(humanoid, rotvec, transl)
        for j, name in enumerate(humanoid.layout.joints):
            if name not in BONE_OF:
                continue
            R, p = avatar.world(BONE_OF[name])
            assert np.abs(p - FLIP @ Y_UP @ places[j]).max() < 1e-4
            assert angle_deg(R, FLIP @ Y_UP @ G[j] @ turns[j].T @ FLIP) < 0.01


def test_the_t_pose_turns_no_bone_and_has_straight_limbs(humanoid):
    """Every bone of an avatar at rest is unturned; arms and fingers lie along X, legs along -Y, feet point along +Z."""
    turns = matrix_from_quat(t_pose(humanoid.layout, humanoid.rest_joints))
    rotvec = np.zeros((humanoid.layout.num_joints, 3))
    for j, p in enumerate(humanoid.layout.parents):
        R = turns[p].T @ turns[j] if p >= 0 else np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])
        rotvec[j] = rotvec_of(R)
    avatar = Avatar().receive(FrameBundle(humanoid).encode(0.0, rotvec, np.zeros(3)))
    for bone in avatar.local:
        assert angle_deg(avatar.local[bone], np.eye(3)) < 0.01, bone
    at = {bone: avatar.world(bone)[1] for bone in avatar.local}
    for side, x in (("Left", -1.0), ("Right", 1.0)):
        for a, b in (("UpperArm", "LowerArm"), ("LowerArm", "Hand")):
            along = at[side + b] - at[side + a]
            assert np.allclose(along / np.linalg.norm(along), (x, 0, 0), atol=1e-5)
        for a, b in (("UpperLeg", "LowerLeg"), ("LowerLeg", "Foot")):
            along = at[side + b] - at[side + a]
            assert np.allclose(along / np.linalg.norm(along), (0, -1, 0), atol=1e-5)
        along = at[side + "Toes"] - at[side + "Foot"]
        assert abs(along[0]) < 1e-5 and along[2] > 0.05
        for finger, z in (("Thumb", 1.0), ("Index", 0.0), ("Middle", 0.0), ("Ring", 0.0), ("Little", 0.0)):
            for a, b in (("Proximal", "Intermediate"), ("Intermediate", "Distal")):
                if side + finger + b in at:
                    along = at[side + finger + b] - at[side + finger + a]
                    straight = np.array([x, 0.0, z]) / np.hypot(x, z)
                    assert np.allclose(along / np.linalg.norm(along), straight, atol=1e-5), finger
    assert at["Head"][1] > at["Hips"][1]


def rotvec_of(R: np.ndarray) -> np.ndarray:
    angle = np.arccos(np.clip((np.trace(R) - 1) / 2, -1, 1))
    axis = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    return axis * (0.5 if angle < 1e-9 else angle / (2 * np.sin(angle)))


def test_poses_come_back(humanoid):
    rng = np.random.default_rng(1)
    rotvec, transl = rng.normal(0, 0.8, (humanoid.layout.num_joints, 3)), rng.normal(0, 2.0, 3)
    read, where = humanoid.from_unity(*humanoid.to_unity(rotvec, transl))
    known = [j for j, name in enumerate(humanoid.layout.joints) if name in BONE_OF]
    assert np.allclose(matrix_from_rotvec(read[known]), matrix_from_rotvec(rotvec[known]), atol=1e-12)
    assert np.allclose(where, transl, atol=1e-12) and not np.delete(read, known, axis=0).any()


def test_joints_that_are_not_given_rest(humanoid):
    rotvec = np.random.default_rng(2).normal(0, 0.5, (22, 3))
    whole = np.zeros((humanoid.layout.num_joints, 3))
    whole[:22] = rotvec
    for some, every in zip(humanoid.to_unity(rotvec, np.zeros(3)), humanoid.to_unity(whole, np.zeros(3)), strict=True):
        assert np.array_equal(some, every)


def test_a_person_who_faces_minus_y_faces_unitys_z():
    humanoid = Humanoid(SMPL, load_body().rest_joints(np.zeros(10)))
    quat, hips = humanoid.to_unity(np.array([[np.pi / 2, 0, 0]]), np.array([0.3, -2.0, 0.1]))
    assert np.allclose(quat[0], (1, 0, 0, 0), atol=1e-12)
    x, y, z = humanoid.rest_joints[0] + (0.3, -2.0, 0.1)
    assert np.allclose(hips, (-x, z, -y)) and hips[2] > 1.5
    # The left arm raised forwards: in Unity the left is -X, and a turn about +Y brings it to +Z.
    raised = np.zeros((22, 3))
    raised[0], raised[16] = (np.pi / 2, 0, 0), (0, -np.pi / 2, 0)
    avatar = Avatar().receive(FrameBundle(humanoid).encode(0.0, raised, np.zeros(3)))
    along = avatar.world("LeftLowerArm")[1] - avatar.world("LeftUpperArm")[1]
    assert along[2] > 0.9 * np.linalg.norm(along)
    assert np.allclose(quat_from_rotvec(np.zeros(3)), (1, 0, 0, 0))


def test_a_body_that_is_no_humanoid_is_refused():
    layout = BodyLayout("dog", ("pelvis", "tail", "head"), (-1, 0, 1), ("trunk",) * 3)
    with pytest.raises(MotionInvalid, match="tail"):
        Humanoid(layout, np.zeros((3, 3)))


def test_a_bundle_has_each_bone_once_after_ok_time_and_root(humanoid):
    packet = FrameBundle(humanoid).encode(1.0, np.zeros((22, 3)), np.zeros(3))
    addresses = [address for address, _ in messages_of(packet)]
    assert addresses[:3] == ["/VMC/Ext/OK", "/VMC/Ext/T", "/VMC/Ext/Root/Pos"]
    assert set(addresses[3:]) == {"/VMC/Ext/Bone/Pos"} and len(addresses) == 3 + len(humanoid.bones)
    assert len(humanoid.bones) == len(set(humanoid.bones)) == (22 if humanoid.layout is SMPL else 52)
