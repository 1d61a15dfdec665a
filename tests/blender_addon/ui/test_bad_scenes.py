"""What users do to a scene of ours: deleted, renamed, doubled, linked and moved. Named, and nothing half-done."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np
import pytest

from blender_addon._exchange.errors import MocapError
from blender_addon._exchange.motion_file import read_motion
from blender_addon.animation.deviation import evaluated_joints
from blender_addon.body.body_file import body_path_of, read_body
from blender_addon.conventions.timing import scene_frame_rate
from blender_addon.errors import BodyMismatch
from blender_addon.export.take import take_of
from blender_addon.export.write import export_take
from blender_addon.scene.bake import add_take
from blender_addon.ui.operators.base import Call, SolverOperator, Steps, current
from blender_addon.ui.operators.import_results import take_motion
from tests.support.narrow_layout import draw_panel
from tests.support.shown_panels import panels_of_all_stages

_NTSC = 24000 / 1001


def draw_all() -> int:
    """Draw every panel that is to be seen, and return how many there are."""
    shown = panels_of_all_stages()
    for cls in shown:
        draw_panel(cls, 300)
    return len(shown)


def refused(operator: str, **given: object) -> str:
    """Return what an operator says when it cannot; '' where it is greyed out."""
    called = getattr(bpy.ops.mocap, operator)
    if not called.poll():
        return ""
    with pytest.raises(RuntimeError) as said:
        called(**given)
    return str(said.value)


def test_a_deleted_body_leaves_panels_that_work_and_is_made_again(mocap, solved_take, solved) -> None:
    armature = mocap.review.armature
    for obj in [*armature.children, armature]:
        bpy.data.objects.remove(obj)
    assert draw_all() > 3 and mocap.review.armature is None
    for operator in ("switch_limbs", "pin_pose", "select_body", "feet_to_floor"):
        assert "Traceback" not in refused(operator)
    again = take_motion(bpy.context, solved.files)
    assert mocap.review.take == again and mocap.review.armature is not None


def test_a_deleted_camera_is_named(mocap, solved_take) -> None:
    bpy.data.objects.remove(mocap.capture.cameras[1].object)
    assert draw_all() > 10
    assert "This camera was deleted" in refused("view_camera", index=1)
    assert bpy.ops.mocap.view_camera(index=0) == {"FINISHED"}


def test_a_deleted_skin_is_named_and_limbs_still_switch(mocap, solved_take) -> None:
    armature = mocap.review.armature
    for child in list(armature.children):
        bpy.data.objects.remove(child)
    assert draw_all() > 10
    assert bpy.ops.mocap.switch_limbs(to="IK") == {"FINISHED"}


def test_a_renamed_armature_is_the_same_body(mocap, solved_take, solved, tmp_path: Path) -> None:
    armature = mocap.review.armature
    armature.name, armature.data.name = "Helga ü", "Rig"
    armature.users_collection[0].name = "Cast"
    assert bpy.ops.mocap.switch_limbs(to="IK") == {"FINISHED"} and bpy.ops.mocap.switch_limbs(to="FK") == {"FINISHED"}
    take_motion(bpy.context, solved.files)
    assert mocap.review.armature == armature and armature.name == "Helga ü"
    export_take(take_of(bpy.context.scene, armature), "bvh", tmp_path / "helga.bvh")


def test_renamed_controls_are_said_and_the_motion_stays(mocap, solved_take) -> None:
    armature = mocap.review.armature
    before = evaluated_joints(bpy.context.scene, armature, 5.0)
    armature.data.bones["left_foot_ik"].name = "IK.L"
    assert draw_all() > 10
    assert "no controls for hands and feet" in refused("switch_limbs")
    np.testing.assert_array_equal(evaluated_joints(bpy.context.scene, armature, 5.0), before)


def test_two_armatures_of_one_name_are_told_apart(mocap, solved_take, solved, tmp_path: Path) -> None:
    """One of them is linked: names are unique in each file, not in a scene."""
    armature = mocap.review.armature
    library = tmp_path / "library.blend"
    bpy.data.libraries.write(str(library), {armature})
    with bpy.data.libraries.load(str(library), link=True) as (_, wanted):
        wanted.objects = [armature.name]
    linked = next(obj for obj in bpy.data.objects if obj.library is not None and obj.type == "ARMATURE")
    bpy.context.scene.collection.objects.link(linked)
    assert linked.name == armature.name and linked != armature
    assert bpy.ops.mocap.switch_limbs(to="IK") == {"FINISHED"}
    assert armature.pose.bones["root"]["left_leg_ik"] == 1.0 and linked.pose.bones["root"]["left_leg_ik"] == 0.0
    assert take_of(bpy.context.scene, linked).armature == linked
    take_motion(bpy.context, solved.files)
    assert mocap.review.armature == armature


def test_a_take_of_another_body_gets_a_body_of_its_own_or_is_refused(mocap, solved_take, solved) -> None:
    motion = read_motion(solved.files.motion)
    body = read_body(body_path_of(motion.provenance))
    before = len(bpy.data.objects), len(bpy.data.actions)
    scene = bpy.context.scene
    with pytest.raises(BodyMismatch):
        add_take(scene, "other", replace(motion, body="other"), body, mocap.review.armature, None, 1)
    assert (len(bpy.data.objects), len(bpy.data.actions)) == before


def test_a_library_that_moved_leaves_panels_and_errors_that_say_so(mocap, solved_take, tmp_path: Path) -> None:
    armature = mocap.review.armature
    library = tmp_path / "cast.blend"
    bpy.data.libraries.write(str(library), {armature})
    project = tmp_path / "shot.blend"
    with bpy.data.libraries.load(str(library), link=True) as (_, wanted):
        wanted.objects = [armature.name]
    linked = next(obj for obj in bpy.data.objects if obj.library is not None and obj.type == "ARMATURE")
    bpy.context.scene.collection.objects.link(linked)
    bpy.ops.wm.save_as_mainfile(filepath=str(project))
    library.rename(tmp_path / "elsewhere.blend")
    bpy.ops.wm.open_mainfile(filepath=str(project))
    assert draw_all() > 3
    gone = next((obj for obj in bpy.data.objects if obj.is_missing), None)
    assert gone is not None
    with pytest.raises(MocapError):
        take_of(bpy.context.scene, gone)


def test_ntsc_film_rate_keeps_time(mocap, solved, scene) -> None:
    scene.render.fps, scene.render.fps_base = 24, 1.001
    action = take_motion(bpy.context, solved.files)
    motion = read_motion(solved.files.motion)
    armature = mocap.review.armature
    assert scene_frame_rate(scene) == pytest.approx(_NTSC, rel=1e-6)
    seconds = (action.frame_range[1] - action.frame_range[0]) / _NTSC
    assert seconds == pytest.approx((motion.num_frames - 1) / motion.fps, abs=1e-4)
    time = float(action["frame_start"]) + 12 / motion.fps * _NTSC
    np.testing.assert_allclose(evaluated_joints(scene, armature, time), motion.joints[12], atol=2e-4)
    assert bpy.ops.mocap.switch_limbs(to="IK") == {"FINISHED"}
    np.testing.assert_allclose(evaluated_joints(scene, armature, time), motion.joints[12], atol=1e-3)
    assert take_of(scene, armature).num_frames == motion.num_frames


def test_a_file_of_a_newer_blender_opens_with_its_takes(mocap, solved_take, tmp_path: Path) -> None:
    """Blender itself reads what it knows of it; ours finds its body and take again."""
    path = tmp_path / "newer.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path), compress=False)
    data = path.read_bytes()
    version = bpy.app.version[0] * 100 + bpy.app.version[1]
    header = re.compile(rb"(BLENDER(?:-v|17-01v0))%03d" % version)  # the second form since Blender 5.0
    assert header.match(data)
    path.write_bytes(header.sub(rb"\g<1>%03d" % (version + 1), data, count=1))
    bpy.ops.wm.open_mainfile(filepath=str(path))
    assert draw_all() > 10
    assert bpy.context.scene.mocap.review.take is not None
    assert bpy.ops.mocap.switch_limbs(to="IK") == {"FINISHED"}


def test_a_run_whose_window_is_closed_ends_and_the_other_window_shows_why(mocap, scene, monkeypatch) -> None:
    killed: list[bool] = []
    process = SimpleNamespace(kill=lambda: killed.append(True), cancelling=False)
    monkeypatch.setattr(current, "run", SimpleNamespace(process=process, verb="solve", error=None, log=[]))
    closed = SimpleNamespace(_stop=lambda context: None, _scene=scene.name)
    SolverOperator.cancel(closed, bpy.context)
    assert killed and not current.busy
    assert "was closed" in " ".join(draw_panel(bpy.types.VIEW3D_PT_mocap_run, 283).drawn)
    assert bpy.ops.mocap.dismiss() == {"FINISHED"}


def test_a_file_browser_that_is_cancelled_leaves_the_runs_of_others(mocap, monkeypatch) -> None:
    killed: list[bool] = []
    run, last = SimpleNamespace(process=SimpleNamespace(kill=lambda: killed.append(True))), SimpleNamespace()
    monkeypatch.setattr(current, "run", run)
    monkeypatch.setattr(current, "last", last)
    SolverOperator().cancel(bpy.context)
    assert not killed and current.run is run and current.last is last


def test_a_run_is_killed_before_its_temporary_files_are_removed(mocap, scene, monkeypatch) -> None:
    done: list[str] = []

    def steps() -> Steps:
        try:
            return (yield Call("solve", [], Path()))
        finally:
            done.append("files removed")

    process = SimpleNamespace(kill=lambda: done.append("killed"))
    monkeypatch.setattr(current, "run", SimpleNamespace(process=process, error=None))
    monkeypatch.setattr(current, "last", None)
    running = SolverOperator()
    running._scene, running._timer, running._steps = scene.name, "timer removed", steps()
    next(running._steps)
    running.cancel(SimpleNamespace(window_manager=SimpleNamespace(event_timer_remove=done.append)))
    assert done == ["killed", "timer removed", "files removed"]
