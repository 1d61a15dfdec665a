"""Import, solve, review and solve again by the operators, with the solver's real process, without a window."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils import Quaternion

import solver_backend
from blender_addon._exchange.motion_file import read_motion
from blender_addon.animation.action import read_pose
from blender_addon.animation.curves import action_curves
from blender_addon.animation.deviation import evaluated_joints
from blender_addon.animation.lanes import current_confidence, read_lane
from blender_addon.body.body_file import default_body_path, read_body
from blender_addon.body.shape import body_mesh, sliders
from blender_addon.conventions.timing import set_scene_frame_rate
from blender_addon.scene.bake import add_take
from blender_addon.ui.operators.base import SolverOperator, current
from solver_backend.exchange.setting import settings_of_class
from solver_backend.exchange.solve_settings import PRESETS, SolveSettings
from solver_backend.io.native.motion_file import read_motion as read_solver_motion
from solver_backend.io.native.motion_file import write_motion


@pytest.fixture
def take(solved_take: bpy.types.Action) -> bpy.types.Action:
    return solved_take


def test_import_says_what_was_recognised_and_sets_the_stage(mocap, solved, tmp_path):
    scene = bpy.context.scene
    scene.frame_start = 11
    assert bpy.ops.mocap.import_capture(filepath=str(solved.folder / "source.npz")) == {"FINISHED"}
    capture = mocap.capture
    assert (capture.frames, capture.fps, len(capture.cameras)) == (30, 60.0, 4)
    assert (scene.frame_start, scene.frame_end, scene.render.fps) == (11, 40, 60)
    assert scene.camera == capture.cameras[0].object and capture.floor.type == "MESH"
    assert all(item.detections.parent == item.object and item.seen_percent > 50 for item in capture.cameras)
    assert Path(capture.file).is_relative_to(tmp_path / "Aufnahmen ü")
    assert (mocap.review.first, mocap.review.last) == (11, 40)


def test_a_dropped_file_stands_for_its_folder(mocap, solved, tmp_path, monkeypatch):
    """Blender hands a folder and names; a frame of detections means the capture it belongs to."""
    camera = tmp_path / "trial" / "pose" / "cam01_json"
    camera.mkdir(parents=True)
    for frame in range(2):
        (camera / f"frame_{frame}.json").touch()
    asked: list[list[str]] = []

    def launch(
        self: SolverOperator, context: bpy.types.Context, verb: str, arguments: list[str], folder: Path
    ) -> set[str]:
        asked.append(arguments)
        return {"FINISHED"}

    monkeypatch.setattr(SolverOperator, "launch", launch)
    bpy.ops.mocap.import_capture(directory=str(camera), files=[{"name": "frame_0.json"}])
    assert asked[0][0] == str(tmp_path / "trial")
    bpy.ops.mocap.import_capture(directory=f"{tmp_path}/trial/")
    assert asked[1][0] == str(tmp_path / "trial")


def test_a_solve_arrives_as_an_action_with_its_provenance(mocap, solved, tmp_path):
    assert bpy.ops.mocap.import_capture(filepath=str(solved.folder / "source.npz")) == {"FINISHED"}
    mocap.solve.preset = "FAST"
    assert bpy.ops.mocap.solve() == {"FINISHED"}
    armature, scene = mocap.review.armature, bpy.context.scene
    take = armature.animation_data.action
    assert take.use_fake_user and take.frame_range[:] == (1.0, 30.0)
    for key in ("motion_file", "report_file", "job_file", "capture_file"):
        assert Path(take[key]).is_file() and Path(take[key]).is_relative_to(tmp_path)
    assert json.loads(take["provenance"])["solver"] == solver_backend.__version__
    assert json.loads(Path(take["job_file"]).read_text("utf-8"))["settings"] == PRESETS["fast"]
    motion = read_motion(Path(take["motion_file"]))
    scene.frame_set(17)
    heads = np.array([armature.pose.bones[name].head for name in ("pelvis", "left_wrist", "right_foot")])
    assert np.abs(heads - motion.joints[16, [0, 20, 11]]).max() < 1e-3
    assert armature.name in mocap.capture.collection.all_objects


@pytest.mark.slow
def test_a_second_solve_is_another_action_of_the_same_body(mocap, take):
    armature = mocap.review.armature
    before = [tuple(point.co) for point in next(action_curves(take)).keyframe_points]
    assert bpy.ops.mocap.solve() == {"FINISHED"}
    second = armature.animation_data.action
    assert mocap.review.armature == armature and second != take and take.use_fake_user
    assert [tuple(point.co) for point in next(action_curves(take)).keyframe_points] == before
    job = json.loads(Path(second["job_file"]).read_text("utf-8"))
    assert job["settings"]["betas"] == pytest.approx(list(take["betas"]), abs=1e-5)
    assert Path(second["motion_file"]).name == "take_02.npz"
    assert bpy.ops.mocap.show_take(name=take.name) == {"FINISHED"}
    assert armature.animation_data.action == take


def test_confidence_is_a_lane_of_the_armature_and_of_each_bone(mocap, take):
    lane = read_lane(take)
    assert lane is not None
    frames, confidence = lane
    motion = read_motion(Path(take["motion_file"]))
    worst = 1 / (1 + (motion.joint_sigma.max(axis=1) / 0.03) ** 2)
    clean = motion.flags == 0
    assert frames.tolist() == list(range(1, 31)) and clean.any()
    assert confidence[clean] == pytest.approx(worst[clean], abs=1e-5)
    bpy.context.scene.frame_set(9)
    armature = mocap.review.armature
    assert armature["confidence"] == pytest.approx(confidence[8], abs=1e-5)
    assert armature["confidence"] == min(current_confidence(armature).values()) < 1


def test_bones_take_the_colour_of_their_confidence_on_every_frame(mocap, take):
    scene, armature = bpy.context.scene, mocap.review.armature
    wrist = armature.pose.bones["left_wrist"]
    curve = next(c for c in action_curves(take) if c.data_path == 'pose.bones["left_wrist"]["confidence"]')
    for point in curve.keyframe_points:
        point.co.y = 0.1 if point.co.x < 15 else 1.0
    assert bpy.ops.mocap.show_confidence() == {"FINISHED"} and bpy.context.mode == "OBJECT"
    scene.frame_set(3)
    red = tuple(wrist.color.custom.normal)
    scene.frame_set(20)
    green = tuple(wrist.color.custom.normal)
    assert red[0] > 2 * red[1] and green[1] > 2 * green[0]
    assert bpy.ops.mocap.show_confidence() == {"FINISHED"} and wrist.color.palette == "DEFAULT"


def test_next_doubtful_range_goes_there_and_selects_it(mocap, take):
    curve = next(c for c in action_curves(take) if c.data_path == '["confidence"]')
    for point in curve.keyframe_points:
        point.co.y = 0.2 if 5 <= point.co.x <= 8 or point.co.x == 25 else 0.9
    review = mocap.review
    visited = []
    for backwards in (False, False, False, True):
        assert bpy.ops.mocap.next_bad_range(backwards=backwards) == {"FINISHED"}
        visited.append((bpy.context.scene.frame_current, review.first, review.last))
    assert visited == [(5, 1, 13), (25, 20, 30), (5, 1, 13), (25, 20, 30)]
    review.below = 0.1
    assert bpy.ops.mocap.next_bad_range() == {"CANCELLED"}


def test_a_pinned_pose_is_the_solvers_own_parameters(mocap, take):
    """Without edits the pin is the motion; an edit of one bone changes that joint alone."""
    scene, review = bpy.context.scene, mocap.review
    motion = read_solver_motion(Path(take["motion_file"]))
    scene.frame_set(12)
    assert bpy.ops.mocap.pin_pose() == {"FINISHED"}
    pin = json.loads(review.pins[0].job_values)
    posed = np.r_[pin["global_orient"], pin["body_pose"]].reshape(24, 3)
    solved_pose = np.r_[motion.global_orient[11], motion.body_pose[11]].reshape(24, 3)
    assert np.abs(posed - solved_pose).max() < 2e-3 and np.abs(pin["transl"] - motion.transl[11]).max() < 1e-4
    knee = review.armature.pose.bones["left_knee"]
    knee.rotation_quaternion = (0.9, 0.435889894, 0.0, 0.0)
    bpy.context.view_layer.update()
    assert bpy.ops.mocap.pin_pose() == {"FINISHED"} and len(review.pins) == 1
    edited = json.loads(review.pins[0].job_values)
    moved = np.abs(np.array(edited["body_pose"]).reshape(23, 3) - posed[1:]).max(axis=1)
    assert moved[3] > 0.1 and np.delete(moved, 3).max() < 1e-4
    assert np.linalg.norm(np.array(edited["body_pose"]).reshape(23, 3)[3]) == pytest.approx(
        2 * np.arccos(0.9), abs=1e-3
    )


def test_pose_back_and_forth(mocap, take, solved):
    motion = read_motion(Path(take["motion_file"]))
    rest = read_body(default_body_path()).rest_joints(motion.betas)
    for frame in (1, 30):
        bpy.context.scene.frame_set(frame)
        pose = read_pose(mocap.review.armature, rest[0])
        assert np.abs(pose.transl - motion.transl[frame - 1]).max() < 1e-5
        assert np.abs(pose.rotvec - motion.rotvec[frame - 1]).max() < 2e-3


def test_errors_are_one_sentence_and_leave_the_scene_as_it_is(mocap, tmp_path):
    empty = tmp_path / "leer"
    empty.mkdir()
    with pytest.raises(RuntimeError, match="The folder contains no supported detections: it is empty"):
        bpy.ops.mocap.import_capture(filepath=str(empty))
    assert not mocap.capture.file and not bpy.data.objects and not current.busy
    assert current.last is not None and current.last.error["code"] == "capture_not_recognised"
    with pytest.raises(RuntimeError, match="Import a capture first"):
        bpy.ops.mocap.solve()


def test_a_folder_that_cannot_be_written_to_is_said_before_anything_runs(mocap, solved, tmp_path):
    (tmp_path / "file").touch()
    mocap.folder = str(tmp_path / "file")
    with pytest.raises(RuntimeError, match=r"The folder for takes cannot be written to.*choose another folder"):
        bpy.ops.mocap.import_capture(filepath=str(solved.folder / "source.npz"))
    assert not current.busy


def test_a_capture_file_that_went_away_is_named(mocap, take, tmp_path):
    mocap.capture.file = str(tmp_path / "gone.npz")
    with pytest.raises(RuntimeError, match="The capture file no longer exists"):
        bpy.ops.mocap.solve()


def test_a_solved_motion_can_be_dropped_too(mocap, solved):
    assert bpy.ops.mocap.import_capture(filepath=str(solved.folder / "take_01.npz")) == {"FINISHED"}
    assert bpy.context.object.animation_data.action.name == "take_01"


def test_solving_a_range_again_writes_the_job_the_solver_is_promised(mocap, take, solved, monkeypatch):
    """The stretch in frames of the capture, the pins in it, and the shape that is there."""
    review, scene = mocap.review, bpy.context.scene
    scene.frame_set(12)
    bpy.ops.mocap.pin_pose()
    scene.frame_set(25)
    bpy.ops.mocap.pin_pose()
    review.first, review.last = 10, 20
    written = []
    monkeypatch.setattr("blender_addon._exchange.job_file.write_job", lambda path, job: written.append(job.as_dict()))
    monkeypatch.setattr(SolverOperator, "launch", lambda *_: {"CANCELLED"})
    bpy.ops.mocap.resolve_range()
    (job,) = written
    resolve = job["resolve"]
    assert (resolve["motion"], resolve["first"], resolve["last"]) == (Path(take["motion_file"]).name, 9, 19)
    assert [pin["frame"] for pin in resolve["pins"]] == [11]
    assert job["settings"]["betas"] == pytest.approx(list(take["betas"]), abs=1e-5)
    set_scene_frame_rate(scene, 30.0)  # the keys stay where they are, so a scene frame is now two of the capture's
    review.first, review.last = 40, 90
    with pytest.raises(RuntimeError, match="are outside the take"):
        bpy.ops.mocap.resolve_range()


def test_a_range_solved_again_goes_through_the_pin_and_leaves_the_rest(mocap, take):
    scene, review = bpy.context.scene, mocap.review
    scene.frame_set(15)
    knee = review.armature.pose.bones["left_knee"]
    turn = Quaternion((1.0, 0.0, 0.0), 0.35)
    knee.rotation_quaternion = knee.rotation_quaternion @ turn
    bpy.context.view_layer.update()
    assert bpy.ops.mocap.pin_pose() == {"FINISHED"}
    pinned = np.array(json.loads(review.pins[0].job_values)["body_pose"]).reshape(23, 3)[3]
    review.first, review.last = 8, 22
    assert bpy.ops.mocap.resolve_range() == {"FINISHED"}
    again = review.armature.animation_data.action
    assert again != take and take.use_fake_user
    before, after = read_motion(Path(take["motion_file"])), read_motion(Path(again["motion_file"]))
    outside = np.r_[0:7, 22:30]
    assert np.abs(before.rotvec[outside] - after.rotvec[outside]).max() < 1e-5
    assert np.abs(before.transl[outside] - after.transl[outside]).max() < 1e-5
    assert np.abs(after.rotvec[14, 4] - pinned).max() < 0.05 < np.abs(before.rotvec[14, 4] - pinned).max()


def test_takes_follow_the_shape_they_were_solved_with(mocap, take, solved, tmp_path):
    other = read_solver_motion(solved.folder / "take_01.npz")
    betas = np.array(other.betas) + 0.5
    path = write_motion(tmp_path / "other.npz", replace(other, betas=betas))
    armature = mocap.review.armature
    motion, body = read_motion(path), read_body(default_body_path())
    same, action = add_take(bpy.context.scene, "other", motion, body, armature, None, 1)
    skin = body_mesh(armature)
    assert same == armature and [key.value for key in sliders(skin)] == pytest.approx(betas.tolist(), abs=1e-5)
    bpy.ops.mocap.show_take(name=take.name)
    assert [key.value for key in sliders(skin)] == pytest.approx(list(take["betas"]), abs=1e-5)
    assert action.name == "other"


def test_a_take_is_thinned_into_another_that_says_how_far_it_is_off(mocap, take):
    assert bpy.ops.mocap.thin_take(by="RATE", keys_per_second=10) == {"FINISHED"}
    thin = mocap.review.take
    assert thin != take and thin.name.endswith("reduced keys") and thin["motion_file"] == take["motion_file"]
    assert len(next(action_curves(thin)).keyframe_points) == 6 < len(next(action_curves(take)).keyframe_points)
    assert thin["keys_deviation"].startswith("6 keys remain. Joints are up to ")
    assert bpy.ops.mocap.show_take(name=take.name) == {"FINISHED"} and mocap.review.take == take


def test_a_take_on_the_nla_plays_on_with_its_panels_and_is_shown_again(mocap, take, tmp_path):
    assert bpy.ops.mocap.mark_take() == {"FINISHED"} and take.asset_data is not None
    scene, armature = bpy.context.scene, mocap.review.armature
    seen = [evaluated_joints(scene, armature, frame) for frame in (5.0, 25.0)]
    assert bpy.ops.mocap.push_down() == {"FINISHED"} and mocap.review.take == take
    animation = armature.animation_data
    assert animation.action is None and [track.mute for track in animation.nla_tracks] == [False]
    for frame, joints in zip((5.0, 25.0), seen, strict=True):
        np.testing.assert_allclose(evaluated_joints(scene, armature, frame), joints, atol=1e-5)
    assert not bpy.ops.mocap.push_down.poll() and bpy.ops.mocap.next_bad_range.poll()
    assert bpy.ops.mocap.pin_pose() == {"FINISHED"}
    bpy.context.view_layer.objects.active = armature
    assert bpy.ops.mocap.export_take(filepath=str(tmp_path / "nla.bvh"), format="bvh") == {"FINISHED"}
    assert bpy.ops.mocap.show_take(name=take.name) == {"FINISHED"} and animation.action == take


def test_every_setting_of_the_solver_is_in_the_panel(mocap):
    mocap.solve.preset = "CUSTOM"
    values = mocap.solve.values()
    assert SolveSettings.from_dict(values) == SolveSettings()  # the panel's defaults are the solver's
    elsewhere = {"betas", "layout", "leave_out"}  # the body's sliders, the markers' and the cameras' own settings
    assert set(SolveSettings.__dataclass_fields__) <= set(mocap.solve.bl_rna.properties.keys()) | elsewhere
    for name, row in settings_of_class(SolveSettings).items():
        if row.in_panel:
            prop = mocap.solve.bl_rna.properties[name]
            words = prop.description.removesuffix(row.metavar or " ").removesuffix(": ")
            assert (prop.name, words.removesuffix(", separated by commas")) == (row.label, row.description)


def test_the_log_is_a_text_of_the_file(mocap, solved):
    bpy.ops.mocap.import_capture(filepath=str(solved.folder / "source.npz"))
    assert bpy.ops.mocap.show_log() == {"FINISHED"} and bpy.ops.mocap.show_log() == {"FINISHED"}
    (text,) = bpy.data.texts
    assert "convert" in text.as_string() and "Done" in text.as_string()
