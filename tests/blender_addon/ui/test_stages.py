"""The sidebar's four stages: which panels are shown, when the next opens, and what stands on top of all."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import bpy
import pytest

from blender_addon._exchange.diagnostics import diagnostic
from blender_addon.body.looks import bodies_of
from blender_addon.conventions.kept_findings import findings_text
from blender_addon.ui.operators.base import current
from blender_addon.ui.operators.import_results import present_capture, take_capture, take_motion
from tests.support.looks import look_of
from tests.support.narrow_layout import NarrowLayout, draw_panel
from tests.support.shown_panels import shown_panels
from tests.support.trial_files import write_trial

WIDE = 400


def on_top() -> str:
    """Return what the top panel draws, in one line."""
    return " | ".join(draw_panel(bpy.types.VIEW3D_PT_mocap_run, WIDE).drawn)


def labels() -> set[str]:
    return {cls.bl_label for cls in shown_panels() if cls.bl_category == "MoCap"}


def test_a_new_scene_shows_how_to_begin_alone(mocap) -> None:
    assert mocap.stage == "CAPTURE"
    assert labels() == {"Stages", "Capture", "From Videos", "Reading Options"}


def test_the_next_stage_opens_when_one_has_succeeded(mocap, solved) -> None:
    stage = take_capture(bpy.context.scene, solved.read)
    present_capture(bpy.context, stage)
    assert (
        mocap.stage == "SOLVE" and labels() == {"Stages", "Solve", "Advanced", "Explain Method"} and "Solve" in on_top()
    )
    take_motion(bpy.context, solved.files)
    assert mocap.stage == "EDIT" and {"Review", "Fix a Range", "Body Shape", "FK and IK"} <= labels()
    assert not {"Capture", "Cameras", "Solve", "Export"} & labels()
    mocap.stage = "DELIVER"
    assert {"Export", "Retarget"} <= labels() and "Review" not in labels()


def test_one_button_solves(mocap, solved_take) -> None:
    buttons = []
    for stage in ("CAPTURE", "SOLVE"):
        mocap.stage = stage
        drawn = [text for cls in shown_panels() for text in draw_panel(cls, WIDE).drawn]
        buttons.append(drawn.count("Solve"))
    assert buttons == [2, 2], "the stage and the button"


def test_a_failure_is_seen_whichever_stage_is_open(mocap, solved_take, monkeypatch) -> None:
    error = {"code": "x", "message": "The camera cam_03 sees nobody.", "hint": "Leave it out."}
    run = SimpleNamespace(verb="solve", error=error, result=None)
    monkeypatch.setattr(current, "last", run)
    monkeypatch.setattr(current, "about", (bpy.context.scene.name, mocap.capture.file))
    for stage in ("CAPTURE", "SOLVE", "EDIT", "DELIVER"):
        mocap.stage = stage
        assert "cam_03" in on_top()


def test_the_take_keeps_its_error_and_its_warnings(mocap, solved, scene) -> None:
    """They stay with the take, also when the run that made it is long forgotten."""
    take_capture(scene, solved.read)
    found = diagnostic("views_disagree_with_result", percent=61.0)
    result = {"reprojection_median_px": 2.14, "diagnostics": [found.as_dict()]}
    take = take_motion(bpy.context, solved.files, result=result)
    assert "2.1 px" in on_top() and "1 warning" in on_top() and "Show" not in on_top()
    assert "Nothing to review" not in on_top(), "a warning is something to review"
    assert current.last is None
    text = " ".join(draw_panel(bpy.types.VIEW3D_PT_mocap_result, WIDE).drawn)
    assert "61 % of the detections" in str(take["warnings"]) and "61 %" in text
    mocap.stage = "DELIVER"
    assert "1 warning" in on_top() and "Show" in on_top()
    mocap.capture.findings = findings_text([found])
    assert "1 problem" in on_top() and "1 warning" not in on_top(), "the same sentence counts once"


def test_problems_of_the_capture_are_one_line_with_a_way_there(mocap, solved_take) -> None:
    found = [diagnostic("views_disagree_with_result", percent=percent) for percent in (61.0, 62.0)]
    mocap.capture.findings = findings_text(found)
    count = len(mocap.capture.problems)
    assert f"{count} problems" in on_top() and "Show" in on_top()
    mocap.stage = "CAPTURE"
    assert "Show" not in on_top() and "Problems" in labels()


def test_ranges_to_review_are_a_button_on_top(mocap, solved_take) -> None:
    mocap.review.below = 0.0
    assert "range" not in on_top()
    mocap.review.below = 1.0
    assert "1 range to review" in on_top()


def test_takes_are_shown_renamed_and_deleted(mocap, solved_take, solved) -> None:
    first = solved_take.name
    second = take_motion(bpy.context, solved.files)
    assert mocap.review.take == second
    second.name = "Kick"
    assert bpy.ops.mocap.delete_take(name="Kick") == {"FINISHED"}
    assert mocap.review.take is not None and mocap.review.take.name == first
    assert "Kick" not in bpy.data.actions and solved.files.motion.is_file()
    assert bpy.ops.mocap.delete_take(name=first) == {"FINISHED"}
    assert mocap.review.take is None and mocap.review.armature is not None
    for cls in shown_panels():
        draw_panel(cls, WIDE)
    with pytest.raises(RuntimeError, match="no take"):
        bpy.ops.mocap.delete_take(name=first)


def test_acquisition_is_a_tab_that_is_asked_for(mocap, monkeypatch) -> None:
    from blender_addon.ui import preferences

    wanted = SimpleNamespace(acquisition=False)
    monkeypatch.setattr(preferences, "preferences_of", lambda context: cast(Any, wanted))
    assert not [cls for cls in shown_panels() if cls.bl_category == "Acquire"]
    wanted.acquisition = True
    assert {"Live", "Sensor Array", "Studio"} <= {
        cls.bl_label for cls in shown_panels() if cls.bl_category == "Acquire"
    }


def test_a_warning_has_a_button_where_its_remedy_is_one(mocap, solved, scene, monkeypatch) -> None:
    take_capture(scene, solved.read)
    found = (
        diagnostic("contradicts", cameras=["cam_02"], frames=[(3, 9)]),
        diagnostic("feet_off_floor", size=6.0, way="above"),
        diagnostic("joints_doubted", size=30.0, off=20.0, shape=4.0),
    )
    names = [item.name for item in mocap.capture.cameras]
    found = (replace(found[0], where=replace(found[0].where, cameras=(names[1],))), *found[1:])
    take_motion(bpy.context, solved.files, result={"diagnostics": [item.as_dict() for item in found]})
    drawn = draw_panel(bpy.types.VIEW3D_PT_mocap_result, WIDE).drawn
    assert drawn.count(f"Leave Out {names[1]}") == 1 and drawn.count("Feet to Floor") == 1
    assert bpy.ops.mocap.leave_camera_out(camera=names[1]) == {"FINISHED"}
    assert [item.use for item in mocap.capture.cameras] == [True, False, True, True]
    mocap.review.take["diagnostics"] = "{no JSON"
    assert not bpy.types.VIEW3D_PT_mocap_result.poll(bpy.context)


def test_a_failed_reading_offers_the_option_that_it_asks_for(mocap, monkeypatch) -> None:
    hint = "Synchronise them, or pass --trim to keep the 90 frames that all have, --by-order to count them."
    error = {
        "code": "frame_count_mismatch",
        "message": "The cameras recorded different numbers of frames.",
        "hint": hint,
    }
    monkeypatch.setattr(current, "last", SimpleNamespace(verb="convert", error=error, result=None))
    monkeypatch.setattr(current, "about", (bpy.context.scene.name, ""))
    assert "Cut to the Shortest" in on_top() and "Frames by Order" in on_top()


@pytest.mark.slow
def test_the_capture_is_read_again_cut_to_the_shortest(mocap, tmp_path) -> None:
    """The button does what its text says: the same folder is read, with the option on."""
    folder = tmp_path / "trial"
    folder.mkdir()
    write_trial(folder, lengths=(20, 18, 20, 20))
    with pytest.raises(RuntimeError, match="different numbers of frames"):
        bpy.ops.mocap.import_capture(filepath=str(folder))
    assert "Cut to the Shortest" in on_top() and not mocap.reading.trim
    assert bpy.ops.mocap.read_again(option="trim") == {"FINISHED"}
    assert mocap.reading.trim and mocap.capture.frames == 18


def test_takes_have_short_names_and_tell_captures_apart(mocap, solved, scene) -> None:
    take_capture(scene, solved.read)
    assert take_motion(bpy.context, solved.files).name == "Take 01"
    other = mocap.captures.add()
    other.name = "walk"
    assert take_motion(bpy.context, solved.files, mocap.captures[0]).name == f"{mocap.captures[0].name} Take 01"


def test_the_list_of_takes_shows_the_error_of_each(mocap, solved, scene) -> None:
    take_capture(scene, solved.read)
    take_motion(bpy.context, solved.files, result={"reprojection_median_px": 2.14})
    take_motion(bpy.context, solved.files, result={"reprojection_median_px": 3.5})
    drawn = draw_panel(bpy.types.VIEW3D_PT_mocap_review, WIDE).drawn
    assert "Take 01, 2.1 px" in drawn and any("3.5 px" in text and "key" in text for text in drawn)


def test_a_stage_that_has_nothing_yet_says_what_comes_first(mocap, solved, scene) -> None:
    for stage in ("SOLVE", "EDIT", "DELIVER"):
        mocap.stage = stage
        assert "Import a capture first." in on_top() and "Import Capture" in on_top(), "with its button"
    take_capture(scene, solved.read)
    assert "Solve the capture first." in on_top() and on_top().split(" | ").count("Solve") == 2
    take_motion(bpy.context, solved.files)
    assert "first." not in on_top()


def heights(panel: type) -> dict[str, float]:
    """Return how tall each text of a panel stands, in usual lines."""

    def below(layout: NarrowLayout, factor: float) -> dict[str, float]:
        here = factor * (layout.given.get("scale_y") or 1.0)
        found = {item.text: here for item in layout.held if not isinstance(item, NarrowLayout)}
        for item in layout.held:
            found |= below(item, factor) if isinstance(item, NarrowLayout) else {}
        return found

    return below(draw_panel(panel, WIDE), 1.0)


def test_the_next_step_of_edit_is_the_tallest_button(mocap, solved_take, monkeypatch) -> None:
    """A take with doubtful ranges asks for a look at them; one without goes on to Deliver."""
    from blender_addon.review import ranges

    assert mocap.stage == "EDIT"
    for found, said in (([(3, 9), (20, 25)], "2 ranges to review"), ([], "Continue to Deliver")):
        monkeypatch.setattr(ranges, "doubtful_ranges", lambda take, below, found=found: found)
        ours = [cls for cls in shown_panels() if cls.bl_category == "MoCap"]
        tall = {text: height for cls in ours for text, height in heights(cls).items()}
        assert tall[said] == max(tall.values()) == pytest.approx(1.6)
        assert [text for text, height in tall.items() if height == tall[said]] == [said]
    mocap.stage = "DELIVER"
    assert "Continue to Deliver" not in on_top()


def test_the_result_says_that_nothing_is_left_to_review(mocap, solved_take, monkeypatch) -> None:
    from blender_addon.review import ranges

    monkeypatch.setattr(ranges, "doubtful_ranges", lambda take, below: [])
    assert "Nothing to review" in on_top()


def test_the_look_is_that_of_all_bodies_and_of_new_ones(mocap, solved) -> None:
    scene = bpy.context.scene
    take_capture(scene, solved.read)
    take_motion(bpy.context, solved.files)
    assert {"Athletic Wear", "Mannequin"} <= set(draw_panel(bpy.types.VIEW3D_PT_mocap_shape, WIDE).drawn)
    assert {look_of(mesh) for mesh in bodies_of(scene)} == {"person"}
    mocap.look = "mannequin"
    [first] = bodies_of(scene)
    assert look_of(first) == "mannequin"
    bpy.data.objects.remove(mocap.review.armature)
    bpy.data.objects.remove(first)
    take_motion(bpy.context, solved.files)
    [second] = bodies_of(scene)
    assert look_of(second) == "mannequin"
    mocap.look = "segments"
    assert look_of(second) == "segments"
    mocap.look = "suit"
    assert look_of(second) == "plain"
    mocap.look = "person"
    assert look_of(second) == "person"
    for name in [a.name for a in second.data.attributes if a.name.startswith("look_")]:
        second.data.attributes.remove(second.data.attributes[name])
    drawn = draw_panel(bpy.types.VIEW3D_PT_mocap_shape, WIDE).drawn
    assert "Mannequin" not in drawn and any(text.startswith("To change the look") for text in drawn)


class _Seen:
    """A context whose viewport a test looks at; everything else is Blender's."""

    def __init__(self, perspective: str) -> None:
        view = SimpleNamespace(view_perspective=perspective, view_location=None, view_distance=0.0)
        self.space_data = SimpleNamespace(type="VIEW_3D", region_3d=view)

    def __getattr__(self, name: str) -> Any:
        return getattr(bpy.context, name)


@pytest.mark.parametrize("perspective", ["PERSP", pytest.param("CAMERA", marks=pytest.mark.slow)])
def test_a_new_body_is_framed_once_and_never_in_a_cameras_view(mocap, solved, perspective: str) -> None:
    take_capture(bpy.context.scene, solved.read)
    context = cast(bpy.types.Context, _Seen(perspective))
    take_motion(context, solved.files)
    view, body = context.space_data.region_3d, mocap.review.armature
    if perspective == "CAMERA":
        assert view.view_location is None and not view.view_distance
        return
    pelvis = body.matrix_world @ body.pose.bones["pelvis"].head
    assert (view.view_location - pelvis).length < 1e-6 and 2.0 < view.view_distance < 8.0
    view.view_location, view.view_distance = "where the user looks", 1.0
    take_motion(context, solved.files)
    assert (view.view_location, view.view_distance) == ("where the user looks", 1.0), "later takes leave it alone"
