"""Heavy work on a body runs in a second Blender, from a file with the body alone."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import bpy
import numpy as np
import pytest

from blender_addon._exchange.contact_parts import CONTACT_PARTS
from blender_addon._exchange.errors import OutputNotWritable
from blender_addon.animation.curves import action_curves, curve_target, keys_of
from blender_addon.animation.deviation import evaluated_joints
from blender_addon.animation.lanes import edit_contact
from blender_addon.animation.takes import PATHS
from blender_addon.body.controls.limbs import LIMBS, ROOT, limb_paths
from blender_addon.body.shape import body_mesh
from blender_addon.errors import TakeMissing
from blender_addon.scene.bake import thinned_take
from blender_addon.scene.session import needs_this_file, save_alone
from blender_addon.ui.operators import base, export, review, takes
from tests.support.library_override import override_linked
from tests.support.solved_capture import SolvedCapture


@pytest.fixture
def apart(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the operators start a second Blender, which they spare themselves without a window."""
    for module in (export, review, takes):
        monkeypatch.setattr(module, "works_here", lambda *of: False)


def test_keys_are_reduced_there_as_they_are_here(apart: None, mocap: Any, solved_take: Any) -> None:
    armature, scenes, name = mocap.review.armature, len(bpy.data.scenes), solved_take.name
    files = [solved_take.get(key) for key in PATHS]
    assert bpy.ops.mocap.thin_take(by="TOLERANCE", tolerance_mm=5.0) == {"FINISHED"}
    made = mocap.review.take
    assert made.name == f"{name} reduced keys" and made.users > 0 and len(bpy.data.scenes) == scenes
    assert [made.get(key) for key in PATHS] == files
    found = evaluated_joints(bpy.context.scene, armature, 10.0)
    bpy.ops.mocap.show_take(name=name)
    solved = evaluated_joints(bpy.context.scene, armature, 10.0)
    assert 1e-5 < np.linalg.norm(found - solved, axis=1).max() <= 5.1e-3
    here = thinned_take(bpy.context.scene, solved_take, armature, None, 5.0)
    for a, b in zip(action_curves(made), action_curves(here), strict=True):
        assert a.data_path == b.data_path and len(a.keyframe_points) == len(b.keyframe_points)


def test_limbs_are_switched_there_as_they_are_here(apart: None, mocap: Any, solved_take: Any) -> None:
    armature, actions, scene = mocap.review.armature, len(bpy.data.actions), bpy.context.scene
    frames = (1.0, 10.0, 17.0, 30.0)
    before = [evaluated_joints(scene, armature, frame) for frame in frames]
    joint = f'pose.bones["{LIMBS[0].joints[1]}"].rotation_quaternion'
    for to in ("IK", "FK"):
        if to == "FK":  # the controls alone have the motion
            for curve in action_curves(solved_take):
                for key in curve.keyframe_points if curve.data_path == joint else ():
                    key.co.y = 1.0
        assert bpy.ops.mocap.switch_limbs(to=to) == {"FINISHED"}
        assert mocap.review.take == solved_take and len(bpy.data.actions) == actions
        assert {armature.pose.bones[ROOT][limb.switch] for limb in LIMBS} == {float(to == "IK")}
        assert armature.data.collections_all[LIMBS[0].collection].is_visible == (to == "IK")
        found = [evaluated_joints(scene, armature, frame) for frame in frames]
        np.testing.assert_allclose(found, before, atol=2e-4)
        keys = {(c.data_path, c.array_index): len(c.keyframe_points) for c in action_curves(solved_take)}
        paths = limb_paths(LIMBS[0]) if to == "IK" else {joint}
        assert {keys[path, 0] for path in paths} == {int(solved_take["frames"])}
        if to == "IK":
            assert bpy.ops.mocap.thin_take(by="TOLERANCE", tolerance_mm=5.0) == {"FINISHED"}
            found = [evaluated_joints(scene, armature, frame) for frame in frames]
            assert 1e-5 < np.linalg.norm(np.subtract(found, before), axis=-1).max() <= 5.1e-3
            bpy.ops.mocap.show_take(name=solved_take.name)
            bpy.data.actions.remove(bpy.data.actions[f"{solved_take.name} reduced keys"])


@pytest.mark.parametrize("skin", ["a dress comes first", "without a parent", "without an object"])
def test_bones_keep_the_shape_of_any_skin(apart: None, mocap: Any, solved_take: Any, skin: str) -> None:
    armature, scene = mocap.review.armature, bpy.context.scene
    mesh = body_mesh(armature)
    mesh.data.shape_keys.key_blocks[1].value = 3.0
    if skin == "a dress comes first":
        dress = bpy.data.objects.new("A dress", bpy.data.meshes.new("Dress"))
        dress.data.from_pydata([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [], [(0, 1, 2)])
        scene.collection.objects.link(dress)
        dress.parent = armature
        dress.shape_key_add(name="Basis")
        assert body_mesh(armature) == mesh
        mesh.parent = None
    elif skin == "without a parent":
        mesh.parent = None
    else:
        bpy.data.objects.remove(mesh)
    bpy.context.view_layer.update()
    before = [evaluated_joints(scene, armature, frame) for frame in (1.0, 17.0)]
    assert bpy.ops.mocap.switch_limbs(to="IK") == {"FINISHED"}
    np.testing.assert_allclose([evaluated_joints(scene, armature, f) for f in (1.0, 17.0)], before, atol=2e-4)


def bend(curve: bpy.types.FCurve) -> None:
    curve.keyframe_points[0].co.y += 0.1


def shake(curve: bpy.types.FCurve) -> None:
    curve.modifiers.new("NOISE")


def step(curve: bpy.types.FCurve) -> None:
    curve.keyframe_points[0].interpolation = "CONSTANT"


def ease(curve: bpy.types.FCurve) -> None:
    curve.keyframe_points[0].handle_right.y += 0.1


def touch(curve: bpy.types.FCurve) -> None:
    review = bpy.context.scene.mocap.review
    part = next(iter(CONTACT_PARTS))
    edit_contact(curve_target(curve.id_data), review.armature, part, (3, 8), [part, 3, 8, True])


@pytest.mark.parametrize("edit", [bend, shake, step, ease, touch])
def test_a_take_that_is_edited_meanwhile_keeps_the_edit(
    apart: None, mocap: Any, solved_take: Any, monkeypatch: pytest.MonkeyPatch, edit: Callable[[Any], None]
) -> None:
    curve = next(curve for curve in action_curves(solved_take) if "left_elbow" in curve.data_path)
    curve.keyframe_points[0].interpolation = "BEZIER"

    def edited(context: bpy.types.Context, **limit: Any) -> Any:
        steps = takes.edit_aside(context, **limit)
        call = next(steps)
        edit(curve)
        result = yield call
        try:
            steps.send(result)
        except StopIteration as end:
            return end.value

    monkeypatch.setattr(review, "edit_aside", edited)
    keys, is_lane = len(keys_of(solved_take)), edit is touch
    assert bpy.ops.mocap.switch_limbs(to="IK", limb="left_arm_ik") == {"FINISHED" if is_lane else "CANCELLED"}
    assert is_lane or len(keys_of(solved_take)) == keys
    assert mocap.review.armature.pose.bones[ROOT]["left_arm_ik"] == float(is_lane)


def steps_of_edit() -> Any:
    """Start an edit up to its call, and return its steps and the folder of its files."""
    steps = takes.edit_aside(bpy.context, keys_within=5.0)
    call = next(steps)
    return steps, call


def test_a_body_and_a_take_that_are_renamed_meanwhile_get_the_edit(mocap: Any, solved_take: Any) -> None:
    armature, name = mocap.review.armature, mocap.review.armature.name
    steps, call = steps_of_edit()
    assert f"--armature={name}" in call.words
    armature.name = solved_take.name = "Renamed"
    bpy.data.objects.new(name, None)  # another object takes the former name
    with pytest.raises(StopIteration) as end:
        steps.send({"action": ""})
    assert end.value.value == {"action": ""}


def test_a_body_that_is_removed_meanwhile_is_named(mocap: Any, solved_take: Any) -> None:
    steps, _ = steps_of_edit()
    bpy.data.objects.remove(mocap.review.armature)
    with pytest.raises(TakeMissing, match="was removed while"):
        steps.send({"action": ""})


def test_a_linked_take_is_found_again(mocap: Any, solved_take: Any, tmp_path: Path) -> None:
    path = tmp_path / "Bibliothek.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True)
    with bpy.data.libraries.load(str(path), link=True) as (_, wanted):
        wanted.actions = [solved_take.name]
    mocap.review.armature.animation_data.action = wanted.actions[0]
    assert mocap.review.take == wanted.actions[0] and mocap.review.take.library is not None
    steps, _ = steps_of_edit()
    with pytest.raises(StopIteration):
        steps.send({"action": ""})


def test_an_override_is_edited_here(mocap: Any, solved_take: Any, tmp_path: Path) -> None:
    """A file with it alone would lose the mesh of its shape keys."""
    path, name = tmp_path / "Bibliothek.blend", mocap.review.armature.name
    assert not needs_this_file([mocap.review.armature])
    bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True)
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    with bpy.data.libraries.load(str(path), link=True) as (_, wanted):
        wanted.collections = [name]
    override_linked(wanted.collections[0])
    bpy.context.view_layer.update()
    review = bpy.context.scene.mocap.review
    assert review.take.library is not None and needs_this_file([review.armature])
    keys = len(body_mesh(review.armature).data.shape_keys.key_blocks)
    assert bpy.ops.mocap.add_face() == {"CANCELLED"}, "the mesh belongs to the other file"
    assert len(body_mesh(review.armature).data.shape_keys.key_blocks) == keys
    assert bpy.ops.mocap.thin_take(by="TOLERANCE", tolerance_mm=5.0) == {"FINISHED"}
    assert review.take.library is None


def test_keys_are_reduced_here_while_a_run_goes_on(
    mocap: Any, solved_take: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(base.current, "run", object())
    assert bpy.ops.mocap.thin_take(by="TOLERANCE", tolerance_mm=5.0) == {"FINISHED"}
    assert mocap.review.take != solved_take and not bpy.ops.mocap.solve.poll()


def test_an_export_whose_scene_was_removed_meanwhile_is_finished(
    apart: None, mocap: Any, solved_take: Any, tmp_path: Path
) -> None:
    chosen = SimpleNamespace(
        output=lambda: tmp_path / "walk.bvh", format="bvh", filename_ext=".bvh", overwrite=True, use_range=False,
        skeleton=True, fps=0.0, unit="m", up="Y", root="body", fingers=True, node="",
        finish=lambda message: {"FINISHED"}, report=lambda *of: None,
    )  # fmt: skip
    steps = export.MOCAP_OT_export_take.steps(chosen, bpy.context)
    next(steps)
    other = bpy.data.scenes.new("Other")
    bpy.context.window.scene = other
    bpy.data.scenes.remove(bpy.data.scenes["Scene"])
    with pytest.raises(StopIteration):
        steps.send({})
    assert "walk.bvh" in other.mocap.exported


def test_a_file_that_cannot_be_written_is_named(mocap: Any, solved_take: Any, tmp_path: Path) -> None:
    with pytest.raises(OutputNotWritable, match="cannot save"):
        save_alone(tmp_path / "none" / "take.blend", mocap.review.armature, (), bpy.context.scene)


def test_an_export_holds_the_body_alone_and_says_where_it_is(
    apart: None, mocap: Any, solved: SolvedCapture, solved_take: Any, tmp_path: Path
) -> None:
    path, here = tmp_path / "ein Gang ü.bvh", tmp_path / "here.bvh"
    assert bpy.ops.mocap.export_take(filepath=str(path), format="bvh", use_range=True, first=3, last=12) == {"FINISHED"}
    assert "Wrote 10 frames" in mocap.exported and str(tmp_path) in mocap.exported
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(export, "works_here", lambda *of: True)
        assert bpy.ops.mocap.export_take(filepath=str(here), format="bvh", use_range=True, first=3, last=12)
    assert path.read_text(encoding="utf-8") == here.read_text(encoding="utf-8")
