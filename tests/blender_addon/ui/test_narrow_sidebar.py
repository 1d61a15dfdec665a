"""Nothing is cut off in a sidebar of 200 pixels, nor in wider ones with more side by side, in English and German."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import bpy
import pytest

from blender_addon._exchange.diagnostics import diagnostic
from blender_addon.body.shape import body_mesh
from blender_addon.conventions.kept_findings import findings_text
from blender_addon.ui.layout import is_narrow, wrapped
from blender_addon.ui.operators.base import current
from blender_addon.ui.panels.solve import ADDED_BY_DEFAULT
from blender_addon.ui.translation import german
from tests.support import narrow_layout
from tests.support.narrow_layout import NarrowContext, draw_panel, text_width
from tests.support.shown_panels import panels_of_all_stages

_NARROW, _DEFAULT = 200, 283  # Pixels; the default is Blender's.
_WIDTHS = (_NARROW, 265, _DEFAULT)


@pytest.fixture(autouse=True, params=("English", "German"))
def language(request, monkeypatch) -> None:
    """Draw every panel in either language."""
    monkeypatch.setattr(narrow_layout, "spoken", german() if request.param == "German" else {})


def cut_off() -> list[str]:
    """Return what no panel has room for."""
    found = []
    for width in _WIDTHS:
        for panel in panels_of_all_stages():
            found += [
                f"{panel.__name__} at {width}: {text!r} needs {need} of {there} px"
                for need, there, text in draw_panel(panel, width).cut
            ]
    return found


def taken_for_blenders() -> list[str]:
    """Return the words that Blender would translate as if they were its own."""
    return [
        f"{panel.__name__}: {text!r}" for panel in panels_of_all_stages() for text in draw_panel(panel, _NARROW).loose
    ]


def test_the_measure_finds_what_is_too_long(mocap) -> None:
    assert 40 < text_width("Some Words") < 90
    assert text_width("Some Words" * 3) == pytest.approx(3 * text_width("Some Words"), rel=0.1)


def test_lines_end_between_words(mocap) -> None:
    layout, context = narrow_layout.NarrowLayout(), NarrowContext(185)
    wrapped(layout, context, f"{ADDED_BY_DEFAULT}, noise-aware", "INFO")
    words = [word for line in layout.drawn for word in line.split()]
    assert {"accelerations,", "contacts,", "noise-aware"} <= {*words} and len(layout.drawn) > 8
    wrapped(layout, context, "/a/folder_of/takes/with_a_name_that_is_too_long", "INFO")
    assert "".join(layout.drawn).endswith("/a/folder_of/takes/with_a_name_that_is_too_long")
    assert "/a/folder_of/" in layout.drawn
    layout.fit(185 - narrow_layout.TABS_AND_MARGINS)
    assert not layout.cut
    for width in range(180, 400, 10):
        wrapped(layout, NarrowContext(width), "The body is 1.695 m tall (± 1.5 %)", "INFO")
    assert not any(line.endswith("±") for line in layout.drawn)


def test_blenders_own_width_is_wide_at_any_scale() -> None:
    for scale in (1.0, 1.0416666, 1.25, 1.5, 2.0):
        preferences = SimpleNamespace(system=SimpleNamespace(ui_scale=scale))
        widths = (int(280 * scale) - 1, int(280 * scale))
        contexts = [
            cast(Any, SimpleNamespace(region=SimpleNamespace(width=w), preferences=preferences)) for w in widths
        ]
        assert [is_narrow(context) for context in contexts] == [True, False], scale


def test_an_empty_scene(mocap) -> None:
    assert "\n".join(cut_off()) == "" and not taken_for_blenders()


def test_a_solved_capture(mocap, solved_take) -> None:
    assert len(panels_of_all_stages()) > 14
    assert "\n".join(cut_off()) == ""
    data = body_mesh(mocap.review.armature).data
    for name in [attribute.name for attribute in data.attributes if attribute.name.startswith("look_")]:
        data.attributes.remove(data.attributes[name])
    mocap.solve.preset, mocap.videos.detector = "CUSTOM", "model"
    mocap.studio.rig, mocap.studio.motion, mocap.studio.film = "RING", "FILE", {"rgb"}
    mocap.retarget.target = bpy.data.objects.new("Rig", bpy.data.armatures.new("Rig"))
    mocap.retarget.map_text, mocap.retarget.label = "{}", "Rigify"
    assert "\n".join(cut_off()) == "" and not taken_for_blenders()


def test_a_run_under_way_and_a_failed_one(mocap, solved_take, monkeypatch) -> None:
    process = SimpleNamespace(cancelling=False, kill=lambda: None)  # what switching the add-on off calls
    for headline in ("Bundle, 3 s left", "Learning the body, 15 s left", "Telling people apart, 3 min left"):
        run = SimpleNamespace(share=0.4, headline=headline, verb="solve", process=process)
        monkeypatch.setattr(current, "run", run)
        assert "\n".join(cut_off()) == "" and not taken_for_blenders()
        assert headline in " ".join(draw_panel(bpy.types.VIEW3D_PT_mocap_run, _NARROW).drawn)
    monkeypatch.setattr(current, "run", None)
    error = {"code": "x", "message": "The camera cam_03 sees nobody in frames 4 to 93.", "hint": "Leave it out."}
    monkeypatch.setattr(current, "last", SimpleNamespace(verb="solve", error=error, result=None))
    monkeypatch.setattr(current, "about", (bpy.context.scene.name, mocap.capture.file))
    assert "\n".join(cut_off()) == ""


def test_what_a_solve_said(mocap, solved_take, monkeypatch) -> None:
    result = {
        "solve_s": 12.3, "reprojection_median_px": 2.1, "marker_median_mm": 4.0, "unsure_frames": 1, "unseen_frames": 12
    }  # fmt: skip
    monkeypatch.setattr(current, "last", SimpleNamespace(verb="solve", error=None, result=result))
    monkeypatch.setattr(current, "about", (bpy.context.scene.name, mocap.capture.file))
    drawn = " ".join(draw_panel(bpy.types.VIEW3D_PT_mocap_result, _NARROW).drawn)
    assert "1 frame to review" in drawn and "12 frames interpolated" in drawn
    assert not cut_off() and not taken_for_blenders()


def test_several_captures_people_and_left_out_cameras(mocap, solved_take) -> None:
    capture = mocap.capture
    for name in ("Anna", "Somebody 2"):
        person = capture.people.add()
        person.name, person.views, person.frames = name, 3.4, 1200
    left_out = capture.left_out.add()
    left_out.name, left_out.first, left_out.last = "cam03", 100, 2000
    found = (
        diagnostic("camera_sees_elsewhere", cameras=["cam_03"]),
        diagnostic("floor_off", lowest=0.6),
        diagnostic("calibration_corrected", result="never", meanings="0.5 times as large"),
        diagnostic("takes_joined", cuts=[20000], first_end=19999, last_start=20000, end=40000),
    )
    capture.findings = findings_text(found)
    assert not cut_off() and not taken_for_blenders()
