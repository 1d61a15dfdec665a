"""Bodies that came without the panels' help: review, export and solving again work on them as on any other."""

from __future__ import annotations

import shutil
from pathlib import Path

import bpy
import numpy as np
import pytest

from blender_addon._exchange.progress import silent
from blender_addon.headless.bake import run_bake
from blender_addon.headless.verb_table import VERBS
from blender_addon.ui.adoption import adopt


def activate(obj: bpy.types.Object) -> None:
    for other in bpy.context.selected_objects:
        other.select_set(False)
    obj.select_set(True)
    bpy.context.view_layer.objects.active = obj


@pytest.fixture(scope="module")
def baked(solved, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a .blend file baked without a window beside its motion, capture and report; the folder was moved since."""
    made = tmp_path_factory.mktemp("baked")
    for name in ("capture.npz", "take_01.npz", "take_01.html"):
        shutil.copy(solved.files.motion.parent / name, made / name)
    wanted = VERBS["bake"].arguments(
        motion=made / "take_01.npz", out=made, capture=made / "capture.npz", no_pictures=True
    )
    run_bake(wanted, silent)
    moved = made.parent / "umgezogen ü"
    made.rename(moved)
    return moved / "take_01.blend"


@pytest.fixture
def opened(mocap, baked: Path) -> bpy.types.PropertyGroup:
    bpy.ops.wm.open_mainfile(filepath=str(baked))
    return bpy.context.scene.mocap


def test_a_file_baked_headless_opens_with_its_panels(opened, baked: Path, tmp_path: Path) -> None:
    capture, review = opened.capture, opened.review
    assert len(opened.captures) == 1 and review.take is not None
    assert len({item.name for item in capture.cameras}) == 4
    assert all(item.detections is not None and item.seen_percent > 50 for item in capture.cameras)
    assert (review.first, review.last) == (1, 30) and capture.frames == 30
    assert Path(bpy.path.abspath(capture.file)) == baked.parent / "capture.npz"
    assert Path(bpy.path.abspath(review.take["report_file"])).name == "take_01.html"
    assert bpy.ops.mocap.next_bad_range.poll() and bpy.ops.mocap.show_confidence.poll()
    activate(review.armature)
    out = tmp_path / "take.bvh"
    assert bpy.ops.mocap.export_take(filepath=str(out), format="bvh") == {"FINISHED"} and out.is_file()
    bpy.context.scene.frame_set(12)
    assert bpy.ops.mocap.pin_pose() == {"FINISHED"}
    review.first, review.last = 6, 18
    before = review.take
    assert bpy.ops.mocap.resolve_range() == {"FINISHED"}
    assert review.take != before and len(opened.captures) == 1
    assert adopt(bpy.context.scene) == 0


def test_an_opened_file_is_adopted_once(opened, baked: Path, tmp_path: Path) -> None:
    shot = tmp_path / "shot.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(shot))
    bpy.ops.wm.open_mainfile(filepath=str(shot))
    captures = bpy.context.scene.mocap.captures
    assert len(captures) == 1 and captures[0].review.take is not None


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["ours", pytest.param("amass", marks=pytest.mark.slow)])
def test_a_motion_by_itself_is_reviewed_exported_and_solved_again(mocap, solved, tmp_path: Path, kind: str) -> None:
    file = tmp_path / "library" / "walk.npz"
    file.parent.mkdir()
    with np.load(solved.files.motion) as stored:
        kept = ("poses", "trans", "betas", "mocap_framerate", "gender") if kind == "amass" else stored.files
        np.savez(file, **{key: stored[key] for key in kept})
    assert bpy.ops.mocap.import_motion(filepath=str(file)) == {"FINISHED"}
    review, capture = mocap.review, mocap.capture
    assert review.take is not None and not capture.file and not capture.cameras
    assert bpy.ops.mocap.export_take.poll() and not bpy.ops.mocap.solve.poll()
    bpy.context.scene.frame_set(15)
    pelvis = review.armature.pose.bones["pelvis"]
    pelvis.location.x += 0.05
    assert bpy.ops.mocap.pin_pose() == {"FINISHED"}
    review.first, review.last = 5, 25
    first = review.take
    assert bpy.ops.mocap.resolve_range() == {"FINISHED"}
    second = review.take
    assert second != first and len(mocap.captures) == 1
    assert sorted(path.name for path in file.parent.iterdir()) == ["walk.npz"], "libraries are not written to"
    assert bpy.ops.mocap.show_take(name=first.name) == {"FINISHED"} and review.take == first
    # Again, on what was solved again.
    assert bpy.ops.mocap.show_take(name=second.name) == {"FINISHED"}
    assert bpy.ops.mocap.resolve_range() == {"FINISHED"} and review.take not in (first, second)
