"""What panels report: of this file and this capture alone, and wherever the user is."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import bpy
import pytest

from blender_addon.ui.operators.base import current
from blender_addon.ui.operators.import_results import take_capture
from blender_addon.ui.panels import run
from tests.support.narrow_layout import NarrowContext
from tests.support.panel_layout import Layout


def drawn(panel: type) -> list[str]:
    layout = Layout()
    panel.draw(SimpleNamespace(layout=layout), NarrowContext(400))
    return layout.drawn


@pytest.fixture
def spoiled(mocap, tmp_path: Path) -> Path:
    path = tmp_path / "broken.c3d"
    path.write_bytes(b"no c3d at all")
    with pytest.raises(RuntimeError):
        bpy.ops.mocap.import_capture(filepath=str(path))
    return path


def is_reported(path: Path) -> bool:
    return any(path.name in text for text in drawn(bpy.types.VIEW3D_PT_mocap_run))


def test_an_error_of_another_file_is_not_shown(mocap, spoiled, tmp_path: Path) -> None:
    assert is_reported(spoiled)
    other = tmp_path / "other.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(other), copy=True)
    bpy.ops.wm.open_mainfile(filepath=str(other))
    assert current.last is None and not is_reported(spoiled)


def test_an_error_is_dismissed_and_stays_with_its_scene(mocap, spoiled, scene) -> None:
    other = bpy.data.scenes.new("other")
    assert current.last_for(other, ("convert",)) is None
    assert bpy.ops.mocap.dismiss() == {"FINISHED"} and not is_reported(spoiled)


def test_a_result_is_shown_for_its_own_capture_alone(mocap, solved_take, solved, tmp_path: Path) -> None:
    run = SimpleNamespace(
        verb="solve", error=None, result={"solve_s": 1.0, "unsure_frames": 3, "unseen_frames": 0}, log=[]
    )
    current.last = cast(Any, run)
    current.about = bpy.context.scene.name, mocap.capture.file
    assert any("3 frames to review" in text for text in drawn(bpy.types.VIEW3D_PT_mocap_result))
    copy = tmp_path / "capture.npz"
    copy.write_bytes((solved.folder / "capture.npz").read_bytes())
    take_capture(bpy.context.scene, {**solved.read, "capture": str(copy), "name": "second"})
    assert not bpy.types.VIEW3D_PT_mocap_result.poll(bpy.context)


def test_another_frame_rate_is_said_on_top_in_headers_and_where_it_is_set(mocap, solved_take, scene) -> None:
    assert not any("Follow" in text or "follow_rate" in text for text in drawn(bpy.types.VIEW3D_PT_mocap_run))
    scene.render.fps = 24
    assert any("at the wrong speed" in text for text in drawn(bpy.types.VIEW3D_PT_mocap_run))
    for name in run.HEADERS:
        assert run.draw_rate_button in getattr(bpy.types, name).draw._draw_funcs, name
    scene.frame_end = 30
    assert bpy.ops.mocap.follow_rate() == {"FINISHED"}
    assert scene.frame_end == 13, "half a second at 24 fps"
    assert not any("at the wrong speed" in text for text in drawn(bpy.types.VIEW3D_PT_mocap_run))


def test_a_range_that_is_not_the_takes_stays(mocap, solved_take, scene) -> None:
    scene.frame_end, scene.render.fps = 250, 24
    assert bpy.ops.mocap.follow_rate() == {"FINISHED"} and scene.frame_end == 250
