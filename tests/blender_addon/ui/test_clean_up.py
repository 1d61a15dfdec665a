"""Cleaning up after a solve: calmer and firmer takes, the floor, few keys by a tolerance, gaps on the timeline."""

from __future__ import annotations

from itertools import product
from types import SimpleNamespace

import bmesh
import bpy
import numpy as np
import pytest

from blender_addon._exchange.errors import JobInvalid
from blender_addon.animation.curves import action_curves
from blender_addon.animation.deviation import evaluated_joints
from blender_addon.animation.lanes import read_lane
from blender_addon.errors import TakeMissing
from blender_addon.review.ranges import sole_height
from blender_addon.ui.scene_job import prepare_job
from blender_addon.ui.setting_properties import ROWS
from solver_backend.exchange.errors import FileDamaged
from solver_backend.geometry.obstacles import read_obstacles
from tests.support.narrow_layout import NarrowContext
from tests.support.panel_layout import Layout


def keys_of(action: bpy.types.Action) -> int:
    return len(next(iter(action_curves(action))).keyframe_points)


def test_smoothing_and_foot_lock_are_options_of_every_solve(solved_take, mocap) -> None:
    assert not {"smoothing", "foot_lock"} & set(prepare_job(bpy.context.scene, None)[0].settings)
    mocap.solve.smoothing, mocap.solve.foot_lock = 3.0, 4.0
    settings = prepare_job(bpy.context.scene, None)[0].settings
    assert settings["smoothing"] == pytest.approx(3.0) and settings["foot_lock"] == pytest.approx(4.0)


def test_every_setting_of_a_solve_is_drawn_in_a_panel(solved_take, mocap) -> None:
    mocap.solve.preset, drawn = "CUSTOM", list[str]()
    panels = (bpy.types.VIEW3D_PT_mocap_solve_settings, bpy.types.VIEW3D_PT_mocap_clean_up)
    for mocap.solve.method, panel in product(("global", "sliding", "noise-aware"), panels):
        layout = Layout()
        panel.draw(SimpleNamespace(layout=layout), NarrowContext(400))
        drawn += layout.drawn
    names = [text.rpartition(".")[2] for text in drawn if text.startswith("prop:MocapSolve")]
    assert set(ROWS) <= set(names), drawn


def test_a_solved_takes_feet_are_held_by_solving_anew(solved_take, mocap) -> None:
    assert mocap.capture.file and not bpy.ops.mocap.lock_feet.poll()


def test_a_detectors_noise_goes_into_the_job_and_is_missed_by_name(solved_take, mocap, tmp_path) -> None:
    assert "noise" not in prepare_job(bpy.context.scene, None)[0].settings
    path = tmp_path / "noise.json"
    path.write_text("{}", encoding="utf-8")
    mocap.solve.noise = str(path)
    assert prepare_job(bpy.context.scene, None)[0].settings["noise"] == str(path)
    path.unlink()
    with pytest.raises(TakeMissing, match=r"Detector Noise no longer exists.*noise\.json"):
        prepare_job(bpy.context.scene, None)


@pytest.fixture
def chair(mocap, scene) -> bpy.types.Object:
    """Return a chosen cube of 0.4 m that stands on a parent, and that a modifier raises by 0.2 m."""
    mesh = bpy.data.meshes.new("Stuhl")
    shape = bmesh.new()
    bmesh.ops.create_cube(shape, size=0.2)
    shape.to_mesh(mesh)
    shape.free()
    chair, parent = bpy.data.objects.new("Stuhl/ü", mesh), bpy.data.objects.new("Room", None)
    for obj in (chair, parent):
        scene.collection.objects.link(obj)
    chair.parent, chair.location, chair.scale = parent, (1.0, 0.0, 0.2), (2.0, 2.0, 2.0)
    parent.location = (0.0, 3.0, 0.0)
    higher = chair.modifiers.new("Higher", "DISPLACE")
    higher.direction, higher.mid_level, higher.strength = "Z", 0.0, 0.1
    mocap.solve.contact_mesh = chair
    return chair


def contact_bounds() -> np.ndarray:
    """Return the lowest and highest corner of the mesh in the job, as the solver reads it."""
    job, path = prepare_job(bpy.context.scene, None)
    [surface] = read_obstacles(path.parent / job.settings["objects"]).surfaces
    return np.stack([surface.min(axis=(0, 1)), surface.max(axis=(0, 1))])


def test_a_chosen_mesh_is_an_object_of_contact(solved_take, mocap, chair) -> None:
    mocap.solve.objects = str(chair.name)  # a file that is missing does not matter
    mocap.review.armature.location.x += 0.3
    bpy.context.view_layer.update()
    assert contact_bounds() == pytest.approx(np.array([[0.5, 2.8, 0.2], [0.9, 3.2, 0.6]]), abs=1e-5)
    bpy.context.scene.unit_settings.scale_length = 0.01  # A body that was built in metres keeps its scale.
    assert contact_bounds()[1] == pytest.approx([0.9, 3.2, 0.6], abs=1e-5)
    mocap.review.armature = None
    assert contact_bounds()[1] == pytest.approx([0.012, 0.032, 0.006], abs=1e-5)


def test_a_chosen_mesh_can_be_undone(solved_take, mocap, chair) -> None:
    bpy.ops.ed.undo_push(message="chosen")
    mocap.solve.contact_mesh = None
    bpy.ops.ed.undo_push(message="cleared")
    assert "objects" not in prepare_job(bpy.context.scene, None)[0].settings
    assert bpy.ops.ed.undo() == {"FINISHED"}
    assert bpy.context.scene.mocap.solve.contact_mesh.name == "Stuhl/ü" and len(contact_bounds())


def _animate_parent(chair: bpy.types.Object) -> None:
    _key_ends(chair.parent)


def _animate_target(chair: bpy.types.Object) -> None:
    lift = bpy.data.objects.new("Lift", bpy.data.armatures.new("Lift"))
    bpy.context.scene.collection.objects.link(lift)
    bpy.context.view_layer.objects.active = lift
    bpy.ops.object.mode_set(mode="EDIT")
    lift.data.edit_bones.new("bone").tail = (0.0, 0.0, 1.0)
    bpy.ops.object.mode_set(mode="OBJECT")
    _key_ends(lift.pose.bones["bone"])
    target = chair.constraints.new("ARMATURE").targets.new()
    target.target, target.subtarget = lift, "bone"


def _key_ends(obj: bpy.types.Object | bpy.types.PoseBone) -> None:
    scene = bpy.context.scene
    for frame, place in ((scene.frame_start, 0.0), (scene.frame_end, 0.1)):
        obj.location.x = place
        obj.keyframe_insert("location", frame=frame)


def _fall(chair: bpy.types.Object) -> None:
    with bpy.context.temp_override(object=chair, active_object=chair, selected_objects=[chair]):
        bpy.ops.rigidbody.object_add()


def _disable(chair: bpy.types.Object) -> None:
    chair.hide_viewport = True
    bpy.context.view_layer.update()


def _flatten(chair: bpy.types.Object) -> None:
    chair.scale.z = 0.0
    bpy.context.view_layer.update()


def _edit(chair: bpy.types.Object) -> None:
    bpy.context.view_layer.objects.active = chair
    bpy.ops.object.mode_set(mode="EDIT")


def _unlink(chair: bpy.types.Object) -> None:
    bpy.context.scene.collection.objects.unlink(chair)


def _empty(chair: bpy.types.Object) -> None:
    chair.data = bpy.data.meshes.new("Empty")


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (_animate_parent, " moves"), (_animate_target, " moves"), (_fall, " moves"), (_unlink, " is not in the scene"),
        (_empty, " has no faces"), (_disable, " is disabled in viewports"), (_edit, " is in Edit Mode"),
        (_flatten, ", or the body, has a scale of 0"),
    ],
)  # fmt: skip
def test_an_unsuitable_mesh_is_named(solved_take, mocap, chair, spoil, message: str) -> None:
    spoil(chair)
    with pytest.raises(JobInvalid, match=f"Stuhl/ü in the Contact Mesh field{message}"):
        prepare_job(bpy.context.scene, None)


def test_a_key_that_moves_nothing_does_not_matter(solved_take, mocap, chair) -> None:
    chair.parent.keyframe_insert("location", frame=1)
    before = bpy.context.scene.frame_current
    assert len(contact_bounds()) and bpy.context.scene.frame_current == before


@pytest.mark.parametrize("first", range(6))
def test_concave_faces_are_solid_from_every_first_corner(solved_take, mocap, chair, first: int) -> None:
    outline = np.roll([(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)], first, axis=0)
    corners = [(*place, height) for height in (0, 1) for place in outline.tolist()]
    sides = [(k, (k + 1) % 6, 6 + (k + 1) % 6, 6 + k) for k in range(6)]
    chair.data = bpy.data.meshes.new("Corner")
    chair.data.from_pydata(corners, [], [(5, 4, 3, 2, 1, 0), (6, 7, 8, 9, 10, 11), *sides])
    job, path = prepare_job(bpy.context.scene, None)
    obstacles = read_obstacles(path.parent / job.settings["objects"])
    corner = obstacles.surfaces[0].min(axis=(0, 1))
    inside, beside = corner + [1.0, 1.0, 1.9], corner + [3.0, 3.0, 1.9]
    distance, _ = obstacles.nearest(np.array([inside, beside]), 1.5)
    assert distance == pytest.approx([-0.1, 1.0], abs=1e-5)


def test_an_open_mesh_is_refused_by_the_solver(solved_take, mocap, chair) -> None:
    chair.data = bpy.data.meshes.new("Sheet")
    chair.data.from_pydata([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [], [(0, 1, 2)])
    with pytest.raises(FileDamaged, match=r"mesh is not closed.*Stuhl_ü\.obj"):
        contact_bounds()


@pytest.mark.parametrize("tolerance_mm", [5.0, 40.0])
def test_few_keys_stay_within_the_tolerance(solved_take, mocap, scene, tolerance_mm: float) -> None:
    body = mocap.review.armature
    full = np.stack([evaluated_joints(scene, body, frame) for frame in range(1, 31)])
    assert bpy.ops.mocap.thin_take(by="TOLERANCE", tolerance_mm=tolerance_mm) == {"FINISHED"}
    few = np.stack([evaluated_joints(scene, body, frame) for frame in range(1, 31)])
    off = 1000 * np.linalg.norm(few - full, axis=-1).max()
    assert off <= tolerance_mm + 0.1 and keys_of(mocap.review.take) < 30
    assert mocap.review.take["keys_deviation_mm"] == pytest.approx(off, abs=0.1)


def test_a_wider_tolerance_needs_fewer_keys(solved_take, mocap) -> None:
    counts = []
    for tolerance in (2.0, 10.0, 60.0):
        assert bpy.ops.mocap.show_take(name=solved_take.name) == {"FINISHED"}
        assert bpy.ops.mocap.thin_take(by="TOLERANCE", tolerance_mm=tolerance) == {"FINISHED"}
        counts.append(keys_of(mocap.review.take))
    assert counts[0] > counts[1] > counts[2] >= 2


def test_keys_by_rate_keep_the_motion_by_default(solved_take, mocap, scene) -> None:
    assert bpy.ops.mocap.thin_take(by="RATE") == {"FINISHED"}
    assert keys_of(mocap.review.take) < 30 and mocap.review.take["keys_deviation_mm"] < 25.0


def test_feet_stand_on_the_floor_and_no_key_is_changed(solved_take, mocap, scene) -> None:
    body, review = mocap.review.armature, mocap.review
    before = [tuple(key.co) for curve in action_curves(solved_take) for key in curve.keyframe_points]
    scene.frame_set(7)
    review.floor_offset = 0.05
    assert body.delta_location.z == pytest.approx(0.05)
    assert bpy.ops.mocap.feet_to_floor() == {"FINISHED"}
    assert sole_height(scene, body, solved_take, 16) == pytest.approx(0.0, abs=1e-5)
    assert scene.frame_current == 7
    assert [tuple(key.co) for curve in action_curves(solved_take) for key in curve.keyframe_points] == before


def test_gaps_are_markers_and_the_users_own_stay(solved_take, mocap, scene) -> None:
    scene.timeline_markers.new("gap in the fence", frame=3)
    read = read_lane(solved_take)
    assert read is not None
    frames, confidence = read
    lane = next(curve for curve in action_curves(solved_take) if curve.data_path == '["confidence"]')
    for key in lane.keyframe_points[9:14]:
        key.co.y = 0.0
    mocap.review.below = 0.02
    assert len(frames) == 30 and confidence.min() > 0.02
    assert bpy.ops.mocap.mark_gaps() == {"FINISHED"} and bpy.ops.mocap.mark_gaps() == {"FINISHED"}
    marks = [(m.name, m.frame) for m in scene.timeline_markers]
    assert marks == [("gap in the fence", 3), ("gap interpolated 10-14", 10)]
    assert bpy.ops.mocap.clear_marks() == {"FINISHED"}
    assert [m.name for m in scene.timeline_markers] == ["gap in the fence"]
