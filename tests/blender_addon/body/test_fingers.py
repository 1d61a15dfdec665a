"""Bodies with finger bones: the skin follows them as the model says; motions without fingers fit all the same."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest

from blender_addon._exchange.body_layout import SMPL, SMPL_HANDS
from blender_addon._exchange.finger_joints import FIRST_FINGER
from blender_addon._exchange.motion_file import MotionFile, read_motion
from blender_addon.animation.deviation import measure_deviation
from blender_addon.body.body_file import default_body_path, pose_joints, read_body, skin, with_own_hands
from blender_addon.conventions.coordinates import R_ARMATURE_BODY
from blender_addon.retarget.motion.figures import Target, actor_of_motion
from blender_addon.retarget.motion.limbs import bend_fingers
from blender_addon.retarget.rig_actor import is_actor, read_actor
from blender_addon.scene.bake import BakeSettings, add_take, bake_take, plays_body
from solver_backend.body.body import load_body
from solver_backend.body.hands import load_body_with_hands, with_fingers
from solver_backend.body.mesh import pose_mesh
from solver_backend.geometry.rotations import exp_so3
from tests.body.oracle import model
from tests.support.moving_fingers import FRAMES, moving_fingers

PLAIN = BakeSettings(floor=False)


@pytest.fixture(scope="module")
def hands():
    return read_body(default_body_path(), SMPL_HANDS)


def test_both_programs_have_the_same_body_with_fingers(hands):
    solvers, motion = load_body_with_hands(), moving_fingers()
    assert hands.layout == SMPL_HANDS and hands.layout.joints == solvers.layout.joints
    R = exp_so3(motion.rotvec)
    expected = pose_mesh(solvers, motion.betas, R[:2, 0], R[:2, 1:], motion.transl[:2])
    of_hands = hands.weights[:, FIRST_FINGER:].sum(axis=1) > 0  # the trunk and the face are shown otherwise
    np.testing.assert_allclose(skin(hands, motion, [0, 1])[:, of_hands], expected[:, of_hands], atol=1e-6)


def test_bones_and_skin_follow_every_finger(scene, hands):
    motion = moving_fingers()
    take = bake_take(scene, motion, hands, settings=PLAIN)
    bones = take.armature.data.bones
    assert set(SMPL_HANDS.joints) <= set(bones.keys()) and "left_hand" not in bones
    assert {"Fingers Left", "Fingers Right"} <= {c.name for c in take.armature.data.collections}
    found = measure_deviation(scene, take.armature, take.mesh, hands, motion, take.timing, [0, 7, FRAMES - 1])
    assert found.joints_mm < 0.05 and found.skin_mm < 0.1


def test_a_positive_turn_about_x_bends_every_finger_into_the_palm(scene, hands):
    still = MotionFile("rest", np.zeros((1, 52, 3)), np.zeros((1, 3)), np.zeros(10), 30.0, hands.id, SMPL_HANDS)
    take = bake_take(scene, still, hands, settings=PLAIN)
    take.armature.animation_data_clear()
    bones = take.armature.pose.bones
    for side in ("left", "right"):
        for finger in ("index", "middle", "ring", "pinky", "thumb"):
            bpy.context.view_layer.update()
            last = bones[f"{side}_{finger}3"]
            before, wrist = last.tail.copy(), bones[f"{side}_wrist"]
            down = wrist.z_axis.copy()
            bones[f"{side}_{finger}1"].rotation_quaternion = (np.cos(0.2), np.sin(0.2), 0.0, 0.0)
            bpy.context.view_layer.update()
            assert (last.tail - before).dot(down) > 0.004, (side, finger)


def test_a_motion_without_fingers_rests_the_hands_of_a_body_with_fingers(scene, hands, files):
    armature, _ = add_take(scene, "first", moving_fingers(), hands, None, None, 1)
    motion = replace(files.motion, body=hands.id, joints=None)
    again, action = add_take(scene, "second", motion, hands, armature, None, 1)
    assert again is armature
    scene.frame_set(1)
    assert all(armature.pose.bones[name].rotation_quaternion[0] == 1.0 for name in SMPL_HANDS.joints[22:])
    _, expected = pose_joints(read_body(default_body_path()).rest_joints(motion.betas), motion.rotvec, motion.transl)
    wrist = armature.matrix_world @ armature.pose.bones["left_wrist"].head
    assert action is armature.animation_data.action
    # The sliders stay at the first take's shape until they are set: only the wrist's turn is compared.
    assert np.isfinite(np.array(wrist)).all() and expected.shape[1] == 24


def test_a_motion_with_fingers_gets_a_body_with_fingers(scene, hands, files):
    plain = read_body(default_body_path())
    armature, _ = add_take(scene, "plain", replace(files.motion, body=plain.id, joints=None), plain, None, None, 1)
    assert "left_hand" in armature.data.bones
    assert not plays_body(armature, moving_fingers(), hands)
    again, _ = add_take(scene, "fingers", moving_fingers(), hands, armature, None, 1)
    assert again is not armature and "left_index1" in again.data.bones


def test_a_body_without_fingers_rests_its_hands_and_says_so(scene, files):
    stand_in = read_body(files.body_path, SMPL_HANDS) if hasattr(files, "body_path") else files.body
    assert stand_in.layout == SMPL
    take = bake_take(scene, moving_fingers(stand_in.id), stand_in, settings=PLAIN)
    assert "The body has no finger joints, so its hands stay at rest." in take.notes
    assert "left_hand" in take.armature.data.bones


@pytest.mark.parametrize("width", [156, 165])
def test_fingers_of_amass_turn_from_a_flat_hand(hands, tmp_path: Path, width: int):
    poses = np.zeros((3, width))
    poses[2, -90:] = 0.3 * np.random.default_rng(2).normal(size=90)
    np.savez(tmp_path / "amass.npz", poses=poses, trans=np.zeros((3, 3)), mocap_framerate=30.0)
    motion = read_motion(tmp_path / "amass.npz")
    assert motion.body_layout == SMPL_HANDS and motion.flat_hands
    own = with_own_hands(motion, hands)
    _, joints = pose_joints(hands.rest_joints(np.zeros(10)), own.rotvec, own.transl)
    for first in (22, 25, 28, 31, 37, 40, 43, 46):
        bones = np.diff(joints[0, first : first + 3], axis=0)
        bones /= np.linalg.norm(bones, axis=1, keepdims=True)
        assert bones[0] @ bones[1] > np.cos(np.radians(10.0)), "a flat hand's fingers are straight"
    assert not own.flat_hands and np.abs(own.rotvec[0, 22:]).max() > 0.2


def test_amass_without_fingers_is_read_as_before(tmp_path: Path):
    np.savez(tmp_path / "amass.npz", poses=np.ones((2, 156)) * ([1] * 66 + [0] * 90), trans=np.zeros((2, 3)),
             mocap_framerate=30.0)  # fmt: skip
    motion = read_motion(tmp_path / "amass.npz")
    assert motion.body_layout == SMPL and not motion.flat_hands and motion.rotvec.shape == (2, 24, 3)


@pytest.mark.parametrize("family", ["SMPL-H", "SMPL-X"])
def test_files_of_the_smpl_family_move_their_own_fingers(tmp_path: Path, family: str):
    np.savez(tmp_path / "model.npz", **{key: value for key, value in model(family).items() if key != "joint2num"})
    own, solvers = read_body(tmp_path / "model.npz", SMPL_HANDS), with_fingers(load_body(tmp_path / "model.npz"))
    assert own.layout == SMPL_HANDS and own.flat_hands is None, "a hand at rest is flat"
    motion = moving_fingers(own.id)
    R = exp_so3(motion.rotvec)
    expected = pose_mesh(solvers, motion.betas, R[:2, 0], R[:2, 1:], motion.transl[:2])
    np.testing.assert_allclose(skin(own, motion, [0, 1]), expected, atol=1e-5)


def test_an_actor_with_fingers_is_retargeted_by_its_body(scene, hands):
    motion = moving_fingers()
    take = bake_take(scene, motion, hands, settings=PLAIN)
    assert is_actor(take.armature)
    shown, (played, _) = actor_of_motion(motion, hands), read_actor(take.armature, scene)
    assert shown.joints.shape == (FRAMES, 24, 3) and played.turns.shape == (FRAMES, 24, 3, 3)
    np.testing.assert_allclose(played.joints, shown.joints, atol=1e-4)
    np.testing.assert_allclose(played.turns, shown.turns, atol=1e-4)
    np.testing.assert_allclose(played.rest[:, :2], shown.rest[:, :2], atol=1e-4)
    assert [len(hand.roles) for hand in shown.hands] == [15, 15]
    for a, b in zip(shown.hands, played.hands, strict=True):
        assert a.roles == b.roles
        np.testing.assert_allclose(a.directions, b.directions, atol=1e-4)
        np.testing.assert_allclose(a.bends, b.bends, atol=1e-4)


def test_another_body_with_fingers_bends_them_as_the_actor_does(hands):
    motion = moving_fingers()
    actor = actor_of_motion(motion, hands)
    rest = hands.rest_joints(motion.betas) @ R_ARMATURE_BODY.T
    names = (*(f"{side}_hand" for side in ("left", "right")), *(role for hand in actor.hands for role in hand.roles))
    joints = [SMPL_HANDS.joints.index(f"{side}_wrist") for side in ("left", "right")]
    joints += [SMPL_HANDS.joints.index("".join(role.rsplit("_", 1))) for role in names[2:]]
    count, eye = len(names), np.tile(np.eye(3), (len(names), 1, 1))
    target = Target(names, names, rest[joints], np.full((count, 3), np.nan), eye, eye, np.full(count, -1),
                    np.full(count, -1), np.eye(3), 1.0, np.zeros(3))  # fmt: skip
    turns = np.tile(np.eye(3), (count, FRAMES, 1, 1))
    G, _ = pose_joints(hands.rest_joints(motion.betas), motion.rotvec, motion.transl)
    expected = np.moveaxis(G[:, joints] @ R_ARMATURE_BODY.T, 1, 0)
    turns[:2] = expected[:2]
    bend_fingers(actor, target, eye, turns)
    np.testing.assert_allclose(turns, expected, atol=1e-6)
