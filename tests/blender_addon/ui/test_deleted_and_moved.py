"""What users do to bodies and cameras by Blender's own operators: found where it is, gone where it was deleted."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy
import pytest

from blender_addon.ui.adoption import on_update
from blender_addon.ui.operators.import_results import take_capture, take_motion
from tests.support.narrow_layout import draw_panel
from tests.support.shown_panels import panels_of_all_stages


def delete(*objects: bpy.types.Object) -> None:
    """Delete objects as the user does: from the scenes, so that what points to them keeps them in the file."""
    select(*objects)
    bpy.ops.object.delete()


def select(*objects: bpy.types.Object) -> None:
    for other in bpy.context.selected_objects:
        other.select_set(False)
    for obj in objects:
        obj.hide_select = False
        obj.select_set(True)
    bpy.context.view_layer.objects.active = objects[0]


def draw_all() -> int:
    shown = panels_of_all_stages()
    for cls in shown:
        draw_panel(cls, 300)
    return len(shown)


def test_a_deleted_body_is_gone_and_solving_makes_one_that_is_seen(mocap, solved_take, solved, scene) -> None:
    armature = mocap.review.armature
    assert armature is not None
    name = armature.name
    delete(armature, *armature.children)
    assert name not in bpy.data.objects and mocap.review.armature is None
    assert not bpy.ops.mocap.select_body.poll() and draw_all() > 3
    take_motion(bpy.context, solved.files)
    body = _active_body(mocap)
    assert body.name in scene.objects and len([o for o in body.children if o.type == "MESH" and o.visible_get()]) == 1
    assert bpy.ops.mocap.select_body() == {"FINISHED"} and bpy.context.object == body


def test_an_armature_deleted_alone_is_gone(mocap, solved_take, solved) -> None:
    delete(mocap.review.armature)
    assert not bpy.ops.mocap.select_body.poll() and draw_all() > 3
    take_motion(bpy.context, solved.files)
    assert bpy.ops.mocap.select_body() == {"FINISHED"}


def test_a_deleted_camera_comes_anew_and_is_never_the_scenes(mocap, solved_take, solved, scene) -> None:
    deleted = mocap.capture.cameras[0].object
    name = deleted.name
    delete(deleted)
    assert name not in bpy.data.objects and mocap.capture.cameras[0].object is None
    with pytest.raises(RuntimeError, match="was deleted"):
        bpy.ops.mocap.view_camera(index=0)
    mocap.reading.scene_setup = "TAKE"
    take_capture(scene, solved.read)
    assert scene.camera is not None and scene.camera.name in scene.objects
    assert all(item.object.name in scene.objects for item in mocap.capture.cameras)


def test_an_import_keeps_no_deleted_cube_alive(mocap, solved, scene) -> None:
    bpy.ops.mesh.primitive_cube_add()
    cube = bpy.context.object
    take_capture(scene, solved.read)
    delete(cube)
    assert "Cube" not in bpy.data.objects


def test_a_deleted_collection_is_gone_and_reading_again_keeps_the_body_that_was_moved_out(
    mocap, solved_take, solved, scene
) -> None:
    body = mocap.review.armature
    for obj in (body, *body.children):
        scene.collection.objects.link(obj)
    bpy.data.batch_remove([mocap.capture.collection])
    assert mocap.capture.collection is None and mocap.review.armature == body
    take_capture(scene, solved.read)
    assert mocap.review.armature == body and mocap.review.take == solved_take
    assert (kept := mocap.capture.collection) is not None
    assert kept.name in [child.name for child in scene.collection.children_recursive]


def test_a_deleted_target_of_retargeting_is_let_go(mocap, solved_take, scene) -> None:
    bpy.ops.object.armature_add()
    rig = bpy.context.object
    mocap.retarget.target = rig
    delete(rig)
    on_update(scene)
    assert mocap.retarget.target is None and draw_all() > 3


def hide(body: bpy.types.Object) -> None:
    body.hide_set(True)


def disable(body: bpy.types.Object) -> None:
    body.hide_viewport = body.hide_select = True


def rename(body: bpy.types.Object) -> None:
    body.name, body.data.name = "Ünsere Heldin", "rig.001"


def edit(body: bpy.types.Object) -> None:
    select(body)
    bpy.ops.object.mode_set(mode="EDIT")


def move_out(body: bpy.types.Object) -> None:
    homes = list(body.users_collection)
    bpy.context.scene.collection.objects.link(body)
    for home in homes:
        home.objects.unlink(body)


@pytest.mark.parametrize("change", [hide, disable, rename, edit, move_out], ids=lambda change: change.__name__)
def test_a_body_is_found_again(mocap, solved_take, solved, change: Callable[[bpy.types.Object], None]) -> None:
    body = mocap.review.armature
    change(body)
    assert mocap.review.armature == body and mocap.review.take == solved_take and draw_all() > 10
    second = take_motion(bpy.context, solved.files)
    assert mocap.review.armature == body and mocap.review.take == second
    assert bpy.ops.mocap.select_body() == {"FINISHED"} and bpy.context.object == body and body.visible_get()


def test_an_excluded_body_is_named(mocap, solved_take) -> None:
    bpy.context.view_layer.layer_collection.children[mocap.capture.collection.name].exclude = True
    assert mocap.review.take == solved_take and draw_all() > 10
    with pytest.raises(RuntimeError, match="collection is hidden or excluded"):
        bpy.ops.mocap.select_body()


def test_of_two_copies_panels_are_about_the_active_one(mocap, solved_take) -> None:
    body = mocap.review.armature
    select(body, *body.children)
    bpy.ops.object.duplicate()
    copy = bpy.context.object
    assert copy != body and mocap.review.armature == copy and draw_all() > 10
    select(body)
    assert mocap.review.armature == body and len(mocap.captures) == 1
    delete(body)
    assert mocap.review.armature == copy, "the copy that is left"


def test_a_body_in_another_scene_has_its_panels_there_alone(mocap, solved_take, scene) -> None:
    body = mocap.review.armature
    other = bpy.data.scenes.new("other")
    other.collection.objects.link(body)
    for home in [c for c in body.users_collection if c != other.collection]:
        home.objects.unlink(body)
    on_update(other)
    assert mocap.review.armature is None and other.mocap.review.armature == body
    assert other.mocap.review.take == solved_take
    with bpy.context.temp_override(scene=other):
        assert bpy.ops.mocap.next_bad_range.poll()
    assert draw_all() > 3


@pytest.fixture
def library(mocap, solved_take, tmp_path: Path) -> Path:
    """Return a saved file with a solved body; an empty scene is open again."""
    path = tmp_path / "cast ü.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.context.scene.mocap.folder = str(tmp_path / "more")
    return path


@pytest.mark.parametrize("link", [False, True], ids=["appended", "linked"])
@pytest.mark.parametrize("what", ["collection", "armature"])
def test_a_body_of_another_file_gets_its_panels(library: Path, tmp_path: Path, what: str, link: bool) -> None:
    scene = bpy.context.scene
    with bpy.data.libraries.load(str(library), link=link) as (there, wanted):
        if what == "collection":
            wanted.collections = [name for name in there.collections if name == "demo"]
        else:
            wanted.objects = [name for name in there.objects if name == "demo"]
    if what == "collection":
        scene.collection.children.link(wanted.collections[0])
    else:
        scene.collection.objects.link(wanted.objects[0])
    bpy.context.view_layer.update()
    mocap = scene.mocap
    body = mocap.review.armature
    assert body is not None and mocap.review.take is not None and len(mocap.captures) == 1
    assert {"Review", "FK and IK", "Export", "Retarget"} <= {cls.bl_label for cls in panels_of_all_stages()}
    assert draw_all() > 6
    assert bpy.ops.mocap.switch_limbs.poll() is not link, "linked bodies are not edited"
    assert bpy.ops.mocap.select_body() == {"FINISHED"}
    out = tmp_path / "take.bvh"
    assert bpy.ops.mocap.export_take(filepath=str(out), format="bvh") == {"FINISHED"} and out.is_file()


def test_undo_after_each_step_finds_everything(mocap, solved_take, solved) -> None:
    bpy.context.preferences.edit.use_global_undo = True
    bpy.ops.ed.undo_push(message="solved")
    body = mocap.review.armature.name
    delete(mocap.review.armature)
    bpy.ops.ed.undo_push(message="deleted")
    take_motion(bpy.context, solved.files)
    bpy.ops.ed.undo_push(message="solved again")
    bpy.ops.ed.undo()
    assert bpy.context.scene.mocap.review.armature is None
    bpy.ops.ed.undo()
    review = bpy.context.scene.mocap.review
    assert review.armature.name == body and review.take is not None
    bpy.ops.ed.redo()
    assert bpy.context.scene.mocap.review.armature is None and draw_all() > 3
    bpy.ops.ed.redo()
    assert bpy.context.scene.mocap.review.take is not None


def _active_body(mocap: Any) -> Any:
    """Return the body, asked for anew: a type checker remembers that it was gone."""
    return mocap.review.armature
