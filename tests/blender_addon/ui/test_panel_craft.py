"""Words and figures of the panels: our own context, plurals, a preset's own values; and a full scene."""

from __future__ import annotations

from types import SimpleNamespace

import bpy
import pytest

from blender_addon.conventions.naming import counted
from blender_addon.ui.operators.base import current
from blender_addon.ui.operators.import_results import take_capture, take_motion
from blender_addon.ui.translation import CONTEXT
from tests.support.narrow_layout import NarrowContext
from tests.support.panel_layout import Layout


def test_no_word_of_ours_is_translated_as_one_of_blenders(mocap) -> None:
    preset = mocap.solve.bl_rna.properties["preset"]
    assert preset.translation_context == CONTEXT
    groups = (mocap, mocap.solve, mocap.reading, mocap.capture, mocap.review, mocap.retarget, mocap.studio)
    for group in groups:
        own = [p for p in group.bl_rna.properties if p.identifier not in ("name", "rna_type")]
        assert own and all(p.translation_context == CONTEXT for p in own), group
    for cls in (bpy.types.MOCAP_OT_solve, bpy.types.VIEW3D_PT_mocap_solve, bpy.types.VIEW3D_PT_mocap_export):
        assert cls.bl_translation_context == CONTEXT


@pytest.mark.parametrize(("count", "said"), [(0, "0 cameras"), (1, "1 camera"), (2, "2 cameras")])
def test_one_is_no_plural(count: int, said: str) -> None:
    assert counted(count, "camera") == said


def test_a_preset_shows_its_own_values_and_custom_those_that_can_be_set(solved_take, mocap) -> None:
    mocap.solve.iterations = 77
    layout = Layout()
    panel = SimpleNamespace(layout=layout)
    mocap.solve.preset = "FAST"
    bpy.types.VIEW3D_PT_mocap_solve_settings.draw(panel, NarrowContext(400))
    assert "label:Iterations: 2" in layout.drawn and "label:Camera Weighting: off" in layout.drawn
    assert "prop:MocapSolve.iterations" not in layout.drawn
    mocap.solve.preset = "CUSTOM"
    bpy.types.VIEW3D_PT_mocap_solve_settings.draw(panel, NarrowContext(400))
    assert "prop:MocapSolve.iterations" in layout.drawn


def test_settings_without_effect_in_the_method_are_not_shown_and_not_sent(solved_take, mocap) -> None:
    def drawn() -> list[str]:
        layout = Layout()
        bpy.types.VIEW3D_PT_mocap_solve_settings.draw(SimpleNamespace(layout=layout), NarrowContext(400))
        return [line for line in layout.drawn if line.startswith("prop:MocapSolve")]

    mocap.solve.preset, mocap.solve.method, mocap.solve.interpolation = "CUSTOM", "sliding", 3
    assert "prop:MocapSolve.interpolation" in drawn() and "prop:MocapSolve.refine_window" not in drawn()
    assert mocap.solve.values()["interpolation"] == 3
    mocap.solve.method = "global"
    assert "prop:MocapSolve.root_curve" not in drawn() and "prop:MocapSolve.refine_window" in drawn()
    assert "interpolation" not in mocap.solve.values()


def test_the_run_under_way_is_on_top_with_its_cancel(mocap, monkeypatch) -> None:
    assert bpy.types.VIEW3D_PT_mocap_run.bl_order < bpy.types.VIEW3D_PT_mocap_capture.bl_order
    under_way = SimpleNamespace(
        share=0.4, headline="Global bundle, 3 s left", verb="solve", process=SimpleNamespace(cancelling=False)
    )
    monkeypatch.setattr(current, "run", under_way)
    layout = Layout()
    bpy.types.VIEW3D_PT_mocap_run.draw(SimpleNamespace(layout=layout), NarrowContext(400))
    assert "progress:Global bundle, 3 s left" in layout.drawn and any(d.startswith("operator:") for d in layout.drawn)


def test_a_full_scene_keeps_everything_of_the_users(mocap, solved) -> None:
    """The factory scene with its cube, and a hundred collections of ten objects."""
    scene = bpy.context.scene
    cube = bpy.data.objects.new("Cube", bpy.data.meshes.new("Cube"))
    scene.collection.objects.link(cube)
    for number in range(100):
        collection = bpy.data.collections.new(f"Set {number:03d}")
        scene.collection.children.link(collection)
        for item in range(10):
            collection.objects.link(bpy.data.objects.new(f"Prop {number:03d}.{item}", None))
    bpy.context.view_layer.objects.active = cube
    cube.select_set(True)
    theirs = sorted(obj.name for obj in scene.objects)
    settings = (scene.render.fps, scene.frame_start, scene.frame_end, scene.camera, scene.frame_current)
    take_capture(scene, solved.read)
    action = take_motion(bpy.context, solved.files)
    assert mocap.review.take == action and mocap.review.armature.name in scene.objects
    assert (scene.render.fps, scene.frame_start, scene.frame_end, scene.camera, scene.frame_current) == settings
    assert bpy.context.view_layer.objects.active == cube and bpy.context.selected_objects == [cube]
    assert set(theirs) <= {obj.name for obj in scene.objects} and len(bpy.data.collections) > 100
