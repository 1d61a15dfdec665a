"""A file that the version before tags has written opens with its capture, cameras, body and take found again."""

from __future__ import annotations

import shutil
from pathlib import Path

import bpy
import pytest

from blender_addon.animation.takes import take_file
from tests.support.narrow_layout import draw_panel
from tests.support.shown_panels import panels_of_all_stages

FORMER = Path(__file__).resolve().parents[2] / "support" / "former_version"


@pytest.fixture
def opened(mocap, tmp_path: Path) -> bpy.types.Scene:
    shutil.copytree(FORMER, tmp_path / "alt ü")
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "alt ü" / "former.blend"))
    return bpy.context.scene


def found(scene: bpy.types.Scene) -> tuple[str, str, list[str]]:
    review, capture = scene.mocap.review, scene.mocap.capture
    assert review.armature is not None and review.take is not None
    return review.armature.name, review.take.name, [item.object.name for item in capture.cameras]


def test_everything_is_found_again_and_stays_so_when_it_is_saved(opened: bpy.types.Scene, tmp_path: Path) -> None:
    names = found(opened)
    assert names == ("demo", "demo take 01", ["cam01", "cam02", "cam03", "cam04"])
    assert opened.mocap.capture.floor.name == "Floor" and opened.mocap.capture.frames == 12
    assert take_file(opened.mocap.review.take, "motion_file").is_file()
    shown = panels_of_all_stages()
    for cls in shown:
        draw_panel(cls, 300)
    assert {"Review", "Export", "Retarget", "Cameras"} <= {cls.bl_label for cls in shown}
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "alt ü" / "neu.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "alt ü" / "neu.blend"))
    assert found(bpy.context.scene) == names


def test_what_was_deleted_in_it_is_let_go(opened: bpy.types.Scene) -> None:
    cube, camera = opened.objects["Cube"], opened.mocap.capture.cameras[1].object
    for obj in bpy.context.view_layer.objects:
        obj.select_set(obj in (cube, camera))
    bpy.ops.object.delete()
    assert "Cube" not in bpy.data.objects and "cam02" not in bpy.data.objects
    assert opened.mocap.capture.cameras[1].object is None


def test_its_limbs_are_switched_and_its_range_is_offered_again(opened: bpy.types.Scene) -> None:
    assert bpy.ops.mocap.switch_limbs(to="IK") == {"FINISHED"}
    assert bpy.ops.mocap.resolve_range.poll() and bpy.ops.mocap.export_take.poll()
