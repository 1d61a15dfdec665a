"""Hand edits stay: outside a range that is solved again to the bit, inside it as pins or after a question."""

from __future__ import annotations

import json
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from mathutils import Quaternion

from blender_addon.animation.curves import action_curves
from blender_addon.animation.deviation import evaluated_joints
from blender_addon.animation.lanes import contact_edits
from blender_addon.animation.takes import take_file
from blender_addon.body.controls.limbs import ROOT, limb_of
from blender_addon.review.ranges import SceneRange, capture_frame, resolve_of
from blender_addon.ui.operators.import_results import take_capture
from blender_addon.ui.operators.review import pin_frame, start_cube
from blender_addon.ui.operators.solve import edited_in_range, runs, spans
from solver_backend.exchange.motion_file import read_motion
from tests.support.narrow_layout import NarrowContext
from tests.support.panel_layout import Layout

ELBOW = 'pose.bones["left_elbow"].rotation_quaternion'


def turn_elbow(review: bpy.types.PropertyGroup, frame: int) -> None:
    """Bend an elbow on a frame and key it, as an animator does."""
    bpy.context.scene.frame_set(frame)
    bone = review.armature.pose.bones["left_elbow"]
    bone.rotation_quaternion = bone.rotation_quaternion @ Quaternion((0.0, 0.0, 1.0), 0.9)
    bone.keyframe_insert("rotation_quaternion")


def keys_of(action: bpy.types.Action) -> dict[tuple[str, int], np.ndarray]:
    found = {}
    for curve in action_curves(action):
        points = curve.keyframe_points
        rows = [(*p.co, len(p.interpolation), len(p.type)) for p in points]  # automatic handles follow neighbours
        found[curve.data_path, curve.array_index] = np.array(rows)
    return found


def outside(keys: np.ndarray, first: int, last: int) -> np.ndarray:
    return keys[(keys[:, 0] < first) | (keys[:, 0] > last)]


def resolve(review: bpy.types.PropertyGroup, first: int, last: int, **given: str) -> None:
    """Solve a range again, fast: what is looked at is what the solve leaves alone."""
    bpy.context.scene.mocap.solve.preset = "FAST"
    review.first, review.last = first, last
    assert bpy.ops.mocap.resolve_range(**given) == {"FINISHED"}


def test_edits_outside_the_range_stay_to_the_bit(mocap, solved_take) -> None:
    review, scene = mocap.review, bpy.context.scene
    turn_elbow(review, 25)
    armature = review.armature
    armature.pose.bones["head"].keyframe_insert("scale", frame=3)  # a curve that no solve writes
    before, pose = keys_of(solved_take), evaluated_joints(scene, armature, 25.0)
    resolve(review, 8, 16)
    second = review.take
    assert second != solved_take and keys_of(solved_take).keys() == before.keys(), "the former take stays as it is"
    after = keys_of(second)
    assert after.keys() == before.keys()
    for place, keys in before.items():
        if "confidence" not in place[0]:
            np.testing.assert_array_equal(outside(after[place], 8, 16), outside(keys, 8, 16), err_msg=str(place))
    np.testing.assert_array_equal(evaluated_joints(scene, armature, 25.0), pose)
    assert not review.pins and second["motion_file"] != solved_take["motion_file"]
    resolve(review, 2, 5)
    np.testing.assert_array_equal(evaluated_joints(scene, armature, 25.0), pose, err_msg="again")


def test_edits_inside_the_range_are_pinned(mocap, solved_take) -> None:
    review, scene = mocap.review, bpy.context.scene
    plain = evaluated_joints(scene, review.armature, 12.0)
    turn_elbow(review, 12)
    edited = evaluated_joints(scene, review.armature, 12.0)
    assert np.linalg.norm(edited - plain, axis=1).max() > 0.1
    review.first, review.last = 8, 16
    assert edited_in_range(bpy.context) == [12]
    scene.frame_set(27)
    resolve(review, 8, 16)
    assert [pin.frame for pin in review.pins] == [12] and scene.frame_current == 27
    np.testing.assert_allclose(evaluated_joints(scene, review.armature, 12.0), edited, atol=1e-3)


def move_root(armature: bpy.types.Object, frames: tuple[int, ...] = (1,)) -> None:
    """Key the root control 0.3 m away and turned, as an animator places a take."""
    root = armature.pose.bones[ROOT]
    root.rotation_mode = "QUATERNION"
    for k, frame in enumerate(frames):
        bpy.context.scene.frame_set(frame)
        root.location, root.rotation_quaternion = (0.3 + k, 0.0, 0.0), Quaternion((0.0, 1.0, 0.0), 0.4)
        root.keyframe_insert("location")
        root.keyframe_insert("rotation_quaternion")


def test_root_motion_is_no_hand_edit_and_counts_once(mocap, solved_take) -> None:
    review, scene = mocap.review, bpy.context.scene
    armature = review.armature
    turn_elbow(review, 12)
    move_root(armature)
    frames = (10.0, 12.0, 14.0, 25.0)
    seen = {frame: evaluated_joints(scene, armature, frame) for frame in frames}
    review.first, review.last = 8, 16
    assert edited_in_range(bpy.context) == [12]
    resolve(review, 8, 16)
    off = {frame: np.linalg.norm(evaluated_joints(scene, armature, frame) - seen[frame], axis=1) for frame in frames}
    assert off[12.0].max() < 1e-4, "a pinned frame stays"
    assert off[25.0].max() < 1e-6
    assert max(off[10.0].max(), off[14.0].max()) < 0.15, "0.3 m if the root counts twice"
    assert max(off[10.0][0], off[14.0][0]) < 0.02, "the pelvis"


@pytest.mark.parametrize("to", ["IK", "FK"])
def test_few_keys_of_a_take_whose_root_moved_stay_in_place(mocap, solved_take, to: str) -> None:
    review, scene = mocap.review, bpy.context.scene
    move_root(review.armature, (1, 30))
    assert bpy.ops.mocap.switch_limbs(to=to) == {"FINISHED"}
    seen = evaluated_joints(scene, review.armature, 20.0)
    assert bpy.ops.mocap.thin_take(by="TOLERANCE", tolerance_mm=5.0) == {"FINISHED"}
    assert np.linalg.norm(evaluated_joints(scene, review.armature, 20.0) - seen, axis=1).max() < 0.006


@pytest.mark.slow
def test_edits_inside_the_range_go_where_the_user_says_so(mocap, solved_take) -> None:
    review, scene = mocap.review, bpy.context.scene
    plain = evaluated_joints(scene, review.armature, 12.0)
    turn_elbow(review, 12)
    resolve(review, 8, 16, edits="DROP")
    assert not review.pins
    assert np.linalg.norm(evaluated_joints(scene, review.armature, 12.0) - plain, axis=1).max() < 0.02


def test_nothing_was_edited_in_a_take_as_solved(mocap, solved_take) -> None:
    review = mocap.review
    review.first, review.last = 1, 30
    assert edited_in_range(bpy.context) == []
    assert bpy.ops.mocap.switch_limbs(to="IK") == {"FINISHED"} and edited_in_range(bpy.context) == []
    assert bpy.ops.mocap.switch_limbs(to="FK") == {"FINISHED"} and edited_in_range(bpy.context) == []
    assert bpy.ops.mocap.thin_take(by="RATE", keys_per_second=8) == {"FINISHED"} and edited_in_range(bpy.context) == []


@pytest.mark.slow
def test_a_foot_moved_by_ik_counts_and_stays(mocap, solved_take) -> None:
    review, scene = mocap.review, bpy.context.scene
    assert bpy.ops.mocap.switch_limbs(to="IK") == {"FINISHED"}
    armature = review.armature
    for frame in (12, 24):
        scene.frame_set(frame)
        armature.pose.bones["left_foot_ik"].location.z += 0.15
        armature.pose.bones["left_foot_ik"].keyframe_insert("location")
    review.first, review.last = 8, 16
    assert edited_in_range(bpy.context) == [12]
    lifted = {frame: evaluated_joints(scene, armature, frame) for frame in (12.0, 24.0, 20.0)}
    resolve(review, 8, 16)
    for frame, limit in ((12.0, 2e-3), (24.0, 1e-6), (20.0, 1e-6)):
        np.testing.assert_allclose(evaluated_joints(scene, armature, frame), lifted[frame], atol=limit)


def test_pins_are_listed_as_ranges_and_cleared_together(mocap, solved_take) -> None:
    pins = mocap.review.pins
    for frame in (12, 5, 7, 6, 14):
        pin_frame(mocap.review, frame)
    assert runs(sorted(pin.frame for pin in pins)) == [(5, 7), (12, 12), (14, 14)]
    assert bpy.ops.mocap.unpin(first=5, last=7) == {"FINISHED"} and [pin.frame for pin in pins] == [12, 14]
    assert bpy.ops.mocap.clear_pins() == {"FINISHED"} and not len(pins) and not bpy.ops.mocap.clear_pins.poll()


def test_contacts_are_added_removed_and_cleared_by_their_buttons(mocap, solved_take) -> None:
    review, ops = mocap.review, bpy.ops.mocap
    bones = review.armature.data.bones
    bones.active = bones["left_knee"]
    review.first, review.last = 5, 12
    at = [capture_frame(solved_take, frame) for frame in (5, 12)]
    assert not ops.clear_contacts.poll()
    assert ops.add_contact() == {"FINISHED"}
    assert contact_edits(solved_take) == [["left_knee", *at, True]]
    assert ops.remove_contact() == {"FINISHED"}
    assert contact_edits(solved_take)[1:] == [["left_knee", *at, False]]
    assert not resolve_of(SceneRange(solved_take, 5, 12)).forgets
    assert ops.clear_contacts() == {"FINISHED"} and not ops.clear_contacts.poll()
    job = resolve_of(SceneRange(solved_take, 5, 12))
    assert job.forgets and not job.contacts


def test_contacts_are_not_edited_outside_the_take_or_in_the_wrong_order(mocap, solved_take) -> None:
    review, bones = mocap.review, mocap.review.armature.data.bones
    bones.active = bones["left_knee"]
    for review.first, review.last in ((12, 5), (-90, -80), (900, 950)):
        with pytest.raises(RuntimeError, match="outside the take or in the wrong order"):
            bpy.ops.mocap.add_contact()
        assert contact_edits(solved_take) == []


def test_contacts_are_edited_below_a_layer_and_stay_with_few_keys(mocap, solved_take) -> None:
    review, bones = mocap.review, mocap.review.armature.data.bones
    bones.active = bones["left_knee"]
    review.first, review.last = 5, 12
    assert bpy.ops.mocap.edit_on_layer() == {"FINISHED"} and review.take == solved_take
    assert bpy.ops.mocap.add_contact() == {"FINISHED"}
    edits = contact_edits(solved_take)
    assert len(edits) == 1
    bpy.ops.mocap.thin_take(by="TOLERANCE", tolerance_mm=5.0)
    assert review.take != solved_take and contact_edits(review.take) == edits


def test_contacts_of_an_earlier_solve_can_be_cleared(mocap, solved_take) -> None:
    entry = {"first": 4, "last": 11, "contacts": [{"part": "head", "first": 4, "last": 9, "touches": True}]}
    solved_take["provenance"] = json.dumps({**json.loads(solved_take["provenance"]), "resolved": [entry]})
    assert bpy.ops.mocap.clear_contacts.poll()
    assert bpy.ops.mocap.clear_contacts() == {"FINISHED"} and not bpy.ops.mocap.clear_contacts.poll()


def test_pins_keep_their_time_at_a_lower_frame_rate_and_back(mocap, solved_take) -> None:
    scene, review, frames = bpy.context.scene, mocap.review, (5, 6, 7, 12)
    full = scene.render.fps
    for frame in frames:
        pin_frame(review, frame)
    for rate in (24, full):
        scene.render.fps = rate
        assert bpy.ops.mocap.follow_rate() == {"FINISHED"}
        assert [capture_frame(review.take, pin.frame + pin.subframe) for pin in review.pins] == [4, 5, 6, 11]
    assert tuple(pin.frame for pin in review.pins) == frames


def test_the_start_up_cube_is_hidden_and_kept(mocap, solved_take) -> None:
    assert start_cube(bpy.context.scene) is None
    bpy.ops.mesh.primitive_cube_add()
    cube = start_cube(bpy.context.scene)
    assert cube is not None and bpy.ops.mocap.hide_cube() == {"FINISHED"} and not cube.visible_get()
    cube.hide_set(False)
    cube.location.x = 1.0
    assert start_cube(bpy.context.scene) is None, "the user moved it"


def test_the_start_up_cube_is_offered_to_be_hidden_before_the_first_solve(mocap, solved) -> None:
    take_capture(bpy.context.scene, solved.read)
    bpy.ops.mesh.primitive_cube_add()
    before = drawn_on_top()
    assert mocap.review.take is None and bpy.ops.mocap.hide_cube() == {"FINISHED"}
    assert before.count("operator:") == drawn_on_top().count("operator:") + 1


def drawn_on_top() -> list[str]:
    layout = Layout()
    bpy.types.VIEW3D_PT_mocap_run.draw(SimpleNamespace(layout=layout), NarrowContext(400))
    return layout.drawn


def test_ik_survives_in_a_range_that_is_solved_again(mocap, solved_take) -> None:
    review, scene, frames = mocap.review, bpy.context.scene, (4.0, 8.0, 12.0, 16.0, 20.0)
    armature = review.armature
    solved = [evaluated_joints(scene, armature, frame) for frame in frames]
    assert bpy.ops.mocap.switch_limbs(to="IK", limb="left_arm_ik") == {"FINISHED"}
    resolve(review, 8, 16)
    root = armature.pose.bones["root"]
    again = read_motion(take_file(review.take, "motion_file"))
    assert again.joints is not None
    for frame, expected in zip(frames, solved, strict=True):
        expected = again.joints[int(frame) - 1] if 8 <= frame <= 16 else expected
        np.testing.assert_allclose(evaluated_joints(scene, armature, frame), expected, atol=1e-4)
        assert root["left_arm_ik"] == 1.0 and root["right_arm_ik"] == 0.0
    scene.frame_set(12)
    wrist, at = armature.pose.bones["left_wrist"], armature.pose.bones[limb_of("left_arm_ik").control]
    before = wrist.head.copy()
    at.location.z += 0.02
    bpy.context.view_layer.update()
    assert 0.003 < (wrist.head - before).length < 0.03, "the control of the range moves the hand"


@pytest.mark.parametrize("options", [{"by": "TOLERANCE", "tolerance_mm": 5.0}, {"by": "RATE", "keys_per_second": 8.0}])
def test_few_keys_are_of_the_edited_take(mocap, solved_take, options: dict) -> None:
    review, scene = mocap.review, bpy.context.scene
    for frame in (18, 19, 20, 21, 22):
        turn_elbow(review, frame)
    seen = evaluated_joints(scene, review.armature, 20.0)
    assert bpy.ops.mocap.thin_take(**options) == {"FINISHED"}
    off = np.linalg.norm(evaluated_joints(scene, review.armature, 20.0) - seen, axis=1).max()
    assert off < (0.006 if options["by"] == "TOLERANCE" else 0.06) and review.take != solved_take
    assert bpy.ops.mocap.thin_take(**options) == {"FINISHED"}
    assert "reduced keys reduced keys" not in review.take.name


@pytest.mark.slow
def test_a_thinned_take_solved_again_keeps_what_is_seen_outside(mocap, solved_take) -> None:
    review, scene = mocap.review, bpy.context.scene
    assert bpy.ops.mocap.thin_take(by="RATE", keys_per_second=8) == {"FINISHED"}
    frames = (1.0, 5.0, 7.0, 17.0, 19.0, 24.0, 30.0)
    seen = {frame: evaluated_joints(scene, review.armature, frame) for frame in frames}
    resolve(review, 8, 16)
    for frame, joints in seen.items():
        np.testing.assert_allclose(evaluated_joints(scene, review.armature, frame), joints, atol=2e-4)


@pytest.mark.slow
def test_edits_stay_after_the_scene_took_another_frame_rate(mocap, solved_take) -> None:
    review, scene = mocap.review, bpy.context.scene
    turn_elbow(review, 25)
    pose = evaluated_joints(scene, review.armature, 25.0)
    scene.render.fps = 30
    assert bpy.ops.mocap.follow_rate() == {"FINISHED"}
    resolve(review, 4, 8)
    np.testing.assert_allclose(evaluated_joints(scene, review.armature, 13.0), pose, atol=1e-5)


def test_frames_read_as_ranges() -> None:
    assert spans([50, 51, 52, 60]) == "50-52, 60" and spans([7]) == "7"


def test_a_limb_with_a_switch_but_unkeyed_controls_is_posed_by_fk_in_the_range(mocap, solved_take) -> None:
    review = mocap.review
    root = review.armature.pose.bones[ROOT]
    root["left_arm_ik"] = 1.0
    root.keyframe_insert('["left_arm_ik"]', frame=1)
    place = review.armature.pose.bones["left_hand_ik"].location.copy()
    resolve(review, 8, 16)
    switch = 'pose.bones["root"]["left_arm_ik"]'
    [curve] = [curve for curve in action_curves(review.take) if curve.data_path == switch]
    assert [curve.evaluate(frame) for frame in (3, 12, 25)] == [1.0, 0.0, 1.0]
    assert review.armature.pose.bones["left_hand_ik"].location == place
