"""Problems of a reading with the button that remedies each, and the reading options that the buttons set."""

from __future__ import annotations

import json
from pathlib import Path

import bpy
import numpy as np
import pytest

from blender_addon._exchange.diagnostics import Diagnostic, diagnostic
from blender_addon.ui.operators.capture import fix_of
from blender_addon.ui.operators.import_results import take_capture
from blender_addon.ui.panels.parts import draw_finding
from blender_addon.ui.setting_properties import READING_ROWS
from blender_addon.ui.translation import german
from solver_backend.synthesis.embedded.demo import demo_capture
from tests.support.narrow_layout import NarrowContext, NarrowLayout, draw_panel
from tests.support.trial_files import write_trial

WIDE = 400


def drawn(panel: str) -> list[str]:
    return draw_panel(getattr(bpy.types, f"VIEW3D_PT_mocap_{panel}"), WIDE).drawn


@pytest.fixture
def half_size(tmp_path: Path) -> Path:
    """Return a trial whose detections were made in pictures of half the calibration's size."""
    cameras, keypoints = demo_capture().require_multiview()
    some = keypoints.frames(0, 40)
    people = [((some.xy + 0.5) * 0.5 - 0.5, some.confidence)]
    write_trial(tmp_path / "half", cameras=cameras, people=people, names=cameras.names, calibrated=cameras.names)
    return tmp_path / "half"


def test_remedies_name_controls_of_the_panel(mocap) -> None:
    notes = [
        diagnostic("unit_read", unit="m", source="file"),
        diagnostic("person_seen_too", person="B", seen=9, views=2.0),
        diagnostic("points_without_label", count=2, total=40),
        diagnostic("focal_length_of_video", cameras=["A"], size=900.0, share=4.0, source="EXIF"),
    ]
    layout = NarrowLayout()
    for note in notes:
        draw_finding(layout, NarrowContext(1600), note)
    unit, person, labels, lens = layout.drawn
    assert "*Unit*" in unit and "use the list of people" in person and "`markers label`" in labels
    assert "*Lenses* or *Focal Length*" in lens


@pytest.mark.parametrize(
    ("code", "control", "values"),
    [
        ("gloves_time", "*Gloves Start At*", {"result": "unknown"}),
        ("gloves_cover_part", "*Gloves Start At*", {"share": 40.0}),
        ("clocks_assumed", "*Sync*", {"reason": "as_filmed"}),
    ],
)
def test_an_option_of_another_verb_is_not_taken_for_a_setting(
    mocap, code: str, control: str, values: dict[str, object]
) -> None:
    layout = NarrowLayout()
    draw_finding(layout, NarrowContext(1600), diagnostic(code, **values))
    text = " ".join(layout.drawn)
    assert control in text and "*Start Offsets*" not in text and "*Synchronise*" not in text


@pytest.mark.slow
def test_a_correction_is_taken_back_by_its_button(mocap, half_size: Path) -> None:
    assert bpy.ops.mocap.import_capture(filepath=str(half_size)) == {"FINISHED"}
    [found] = [item for item in mocap.capture.problems if "corrected" in item.code]
    fix = fix_of(found)
    assert fix is not None and fix.text in drawn("problems")
    assert "Show" in drawn("run") and "Fix" not in drawn("run"), "to take a correction back is no remedy"
    assert not mocap.reading.as_calibrated
    module, name = fix.operator.split(".")
    assert getattr(getattr(bpy.ops, module), name)(**dict(fix.values)) == {"FINISHED"}
    assert mocap.reading.as_calibrated and len(mocap.captures) == 1
    assert not any("corrected" in item.code for item in (*mocap.capture.problems, *mocap.capture.notes))


@pytest.mark.parametrize(
    ("found", "option", "value"),
    [
        (
            diagnostic("world_levelled", reason="shown", tilt=9.0, sigma=0.5, floor=0.2, witnesses="the feet"),
            "level",
            "off",
        ),
        (diagnostic("floor_by_feet", depth=0.4), "level", "off"),
        (diagnostic("floor_off", lowest=0.6), "level", "on"),
        (diagnostic("person_tilted", size=12.0, sigma=1.0), "level", "on"),
        (diagnostic("starts_apart", reference="a", starts="b 40"), "sync", "off"),
        (diagnostic("unit_by_person", unit="mm", stature=1.7, read=17.0, guessed="cm"), "unit", "cm"),
        (diagnostic("marker_unit_not_as_stated", stated="mm", spread=0.002, unit="m"), "unit", "mm"),
        (diagnostic("up_by_person", basis="axis", axis="Y"), "up_axis", "z"),
        (diagnostic("person_along_axis", axis="-Y"), "up_axis", "-y"),
        (diagnostic("frame_rate_contradicts", rate=30.0, video=59.94), "fps", "59.94"),
        (diagnostic("takes_joined", cuts=[200], first_end=199, last_start=200, end=400), "frames", "0 199"),
        (diagnostic("camera_names_exchanged", pairs="a b"), "as_calibrated", "on"),
        (diagnostic("detections_corrected", found="v"), "as_calibrated", "on"),
    ],
)
def test_each_option_that_a_sentence_names_is_set_by_its_button(
    mocap, solved, scene, monkeypatch, found: Diagnostic, option: str, value: str
) -> None:
    take_capture(scene, solved.read | {"diagnostics": [found.as_dict()]})
    read: list[list[str]] = []
    monkeypatch.setattr(
        "blender_addon.ui.operators.imports.MOCAP_OT_import_capture.launch",
        lambda self, context, verb, arguments, folder: read.append(arguments) or {"FINISHED"},
    )
    mocap.capture.source = str(solved.folder / "capture.npz")
    fix = fix_of(found)
    assert fix is not None and fix.text in drawn("problems")
    assert dict(fix.values) == {"option": option, "value": value}
    assert bpy.ops.mocap.read_again(option=option, value=value) == {"FINISHED"}
    kept = getattr(mocap.solve if option == "sync" else mocap.reading, option)
    stored = {"on": True, "59.94": pytest.approx(59.94), "30": 30.0}.get(value, value)
    assert kept == stored or (option, kept) == ("level", value)
    flag = f"--{option.replace('_', '-')}"
    assert any(word.partition("=")[0] == flag for word in read[0]), read[0]


def test_the_remedy_of_the_first_problem_stands_beside_their_count(mocap, solved, scene) -> None:
    name = solved.read["cameras"][1]["name"]
    found = [
        diagnostic("starts_apart", reference="a", starts="b 40"),
        diagnostic("camera_sees_elsewhere", cameras=[name]),
        diagnostic("cameras_shifted", cameras=[name], shifts=["a by 3 px"]),
    ]
    take_capture(scene, solved.read | {"diagnostics": [item.as_dict() for item in found]})
    assert {"3 problems", "Fix"} <= set(drawn("run"))
    assert {f"Leave Out {name}", "Refine Calibration"} <= set(drawn("problems"))


def test_what_the_check_of_cameras_finds_has_its_button(mocap, solved, scene, monkeypatch) -> None:
    take_capture(scene, solved.read)
    found = diagnostic("camera_moved", amount="check", cameras=["cam_02"], size=16.7, best=7.3)
    words = {"verdict": "does not fit", "stature_m": 1.7, "tilt_deg": 0.1, "tilt_sigma_deg": 0.1, "findings": ["x"]}
    operator = bpy.types.MOCAP_OT_check_cameras
    monkeypatch.setattr(
        operator, "launch", lambda self, *_: self.answer(self.resume(words | {"diagnostics": [found.as_dict()]}))
    )
    assert bpy.ops.mocap.check_cameras() == {"FINISHED"}
    shown = drawn("cameras")
    assert "seems to have moved" in " ".join(shown) and shown.count("Refine Calibration") == 2


def test_a_value_that_no_option_has_is_refused(mocap, solved, scene) -> None:
    """A capture's file may state anything."""
    take_capture(scene, solved.read)
    for option, value in (("unit", "parsec"), ("fps", "fast"), ("no_option", "on"), ("bl_rna", "on")):
        with pytest.raises(RuntimeError, match="reading options"):
            bpy.ops.mocap.read_again(option=option, value=value)


def test_words_of_buttons_are_german_too(mocap) -> None:
    assert {"Fix", "As Written", "Keep Calibrated Level", "As Recorded", "Keep Z Up", "Level from Person"} <= set(
        german()
    )


def test_every_setting_of_time_and_world_has_its_row_and_its_option(mocap) -> None:
    reading = mocap.reading
    assert not {f"--{name.replace('_', '-')}" for name in READING_ROWS} & set(reading.arguments())
    assert {row.label for row in READING_ROWS.values()} <= set(drawn("reading"))
    reading.camera, reading.offset = "hall left=cam02, door=cam03", "cam02=60,cam03=-4"
    reading.by_order, reading.frames, reading.level = True, "100 399", "on"
    assert reading.arguments() == [
        "--camera=hall left=cam02", "--camera=door=cam03", "--offset=cam02=60", "--offset=cam03=-4", "--by-order",
        "--frames", "100", "399", "--level=on",
    ]  # fmt: skip


def test_cameras_by_other_names_and_a_range_are_read_from_the_panel(mocap, tmp_path: Path) -> None:
    write_trial(tmp_path / "trial", names=("one", "two", "three", "four"), frames=30)
    mocap.reading.camera = "one=cam_1, two=cam_2, three=cam_3, four=cam_4"
    mocap.reading.frames = "5 24"
    assert bpy.ops.mocap.import_capture(filepath=str(tmp_path / "trial")) == {"FINISHED"}
    assert mocap.capture.frames == 20
    assert "cameras_assigned_by_views" not in mocap.capture.findings
    mocap.reading.frames = "24 5"
    with pytest.raises(RuntimeError, match="frames"):
        bpy.ops.mocap.import_capture(filepath=str(tmp_path / "trial"))


def test_json_of_messages_is_plain(mocap, solved, scene) -> None:
    take_capture(scene, solved.read | {"diagnostics": [diagnostic("floor_off", lowest=np.float64(0.6)).as_dict()]})
    assert [item["code"] for item in json.loads(mocap.capture.findings)] == ["floor_off"]
    assert [item.code for item in mocap.capture.problems] == ["floor_off"]
    hostile = diagnostic("scene_message", text="a \x1b[31m\rb")
    take_capture(scene, solved.read | {"diagnostics": [hostile.as_dict()]})
    assert any("b" in text for text in drawn("problems")) and not set("".join(drawn("problems"))) & set("\x1b\r")
