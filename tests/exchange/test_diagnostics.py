"""Diagnostics: data in files, words at the edge, and nothing refused that is merely unknown."""

from __future__ import annotations

import json
import re
import string
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from solver_backend.exchange.diagnostics import (
    Diagnostic,
    Remedy,
    Severity,
    Where,
    diagnostic,
    frames_text,
    is_of_reading,
    list_refusals,
    load_table,
    merge,
    read_diagnostics,
    sentence,
    summarise,
    word,
)  # fmt: skip

LEGS = diagnostic("limbs_exchanged", cameras=["b"], frames=[(30, 59)], remedy=Remedy.REPAIRED, part="legs", size=8.0)
FAR = diagnostic("frames_unsure", data="views", frames=[(3, 9), (12, 12)], percent=4.0)
TALL = diagnostic("stature_odd", severity=Severity.WARNING, size=5.78, least=1.2, most=2.2)


def variants(code: str) -> list[dict[str, str]]:
    """Return each choice of the named values of a code's parameters."""
    words = load_table()[code].words
    return [dict(zip(words, chosen, strict=True)) for chosen in product(*words.values())]


def filled(code: str, chosen: dict[str, str]) -> Diagnostic:
    """Return a diagnostic of a code with every value that its sentences name."""
    entry = load_table()[code]
    texts = [entry.text, entry.remedy, *(entry.words[name][value] for name, value in chosen.items())]
    parts = [part for text in texts for part in string.Formatter().parse(text) if part[1]]
    names = {"cameras": ["cam_b", "cam_c"], "markers": ["LKNE", "RKNE"], "joints": ["nose", "neck"]}
    places = {"file", "person", "camera", "marker", "joint", "other_camera", "other_marker", "other_joint"}
    given = {str(name): 5.0 if spec and spec[-1] in "fg" else "a part" for _, name, spec, _ in parts}
    values = {name: value for name, value in given.items() if name not in places | names.keys()}
    return diagnostic(code, frames=[(3, 9)], file="f", person="Ann", **names, **values | chosen)


def test_the_table_is_small_and_knows_what_is_found_when() -> None:
    assert 200 < len(load_table()) <= 250
    assert is_of_reading("starts_apart") and not is_of_reading("camera_late") and not is_of_reading("stature_odd")
    assert list_refusals() == (
        "views_contradict", "residual_large", "markers_far", "markers_of_nobody", "stature_odd", "motion_rate_odd",
        "motion_place_impossible",
    )  # fmt: skip


def test_every_code_has_words_and_survives_a_file() -> None:
    for code, chosen in [(name, chosen) for name in load_table() for chosen in variants(name)]:
        found = filled(code, chosen)
        words = word(found, 10.0)
        assert code not in words.what and "{" not in words.what + words.advice
        assert words.what.endswith((".", "?")) and "frames 3-9 (0.70 s)" in words.what
        is_plain = code in ("scene_message", "sensor_back")
        assert words.advice or load_table()[code].severity is Severity.NOTE or is_plain, code
        assert read_diagnostics(json.loads(json.dumps([found.as_dict()]))) == (found,)


def test_stretches_of_one_thing_are_one_sentence():
    later = replace(LEGS, where=replace(LEGS.where, frames=((100, 100),)), values={"part": "legs", "size": 1.0})
    arms = replace(LEGS, values={"part": "arms", "size": 8.0})
    assert [word(item, 60.0).what for item in merge([LEGS, arms, later])] == [
        "Camera b: left and right legs are swapped in frames 30-59 (0.50 s), frame 100. This has been corrected.",
        "Camera b: left and right arms are swapped in frames 30-59 (0.50 s). This has been corrected.",
    ]


def test_many_stretches_are_counted():
    runs = [(10 * n, 10 * n + n) for n in range(10)]
    text = frames_text(runs, 10.0)
    assert text.startswith("frames 40-44 (0.50 s), frames 50-55")
    assert text.endswith("frames 90-99 (1.00 s) and 4 shorter ones")
    assert frames_text([(3, 3)], 10.0) == "frame 3"


def test_a_code_of_another_version_is_shown_by_name():
    told = {
        "code": "lens_fogged",
        "severity": "note",
        "where": {"cameras": ["b"], "frames": [[1, 2]]},
        "values": {"share": 3},
    }
    (found,) = read_diagnostics([told])
    assert sentence(found) == "Another version reported: lens fogged (b, share 3) in frames 1-2."
    assert found.severity is Severity.NOTE


def test_corrected_detections_without_cameras_are_of_all_cameras() -> None:
    told = {"code": "detections_corrected", "values": {"found": "left and right are swapped"}, "remedy": "repaired"}
    (found,) = read_diagnostics([told])
    what, advice = word(found)
    assert what == "The detections of all cameras are wrong: left and right are swapped. This has been corrected."
    assert advice.startswith("Check these cameras' files before you use them")


@pytest.mark.parametrize("values", [{}, {"size": "much"}, {"size": [1, 2], "least": None}])
def test_a_code_with_other_values_is_shown_by_name(values):
    (found,) = read_diagnostics([{"code": "stature_odd", "severity": "warning", "values": values}])
    assert sentence(found).startswith("Another version reported: stature odd")


@pytest.mark.parametrize("nonsense", [None, 3, {"code": "a"}, [None, 3, [], {}, {"code": 4}, {"kind": 3}]])
def test_what_is_no_list_of_diagnostics_holds_none(nonsense):
    assert read_diagnostics(nonsense) == ()


def test_nonsense_in_a_diagnostic_is_left_out():
    where = {"cameras": "b", "frames": [[3, 1], [1], "x", [True, 2]]}
    wrong = {
        "code": "a\x1b[31m",
        "severity": "grave",
        "where": where,
        "values": {"x": float("nan"), "y": {}},
        "remedy": 4,
    }
    (found,) = read_diagnostics([wrong])
    assert (found.severity, found.where, found.remedy) == (Severity.WARNING, Where(), Remedy.REPORTED)
    assert "\x1b" not in sentence(found)


def test_counts_of_numpy_are_whole_and_survive_a_file():
    found = diagnostic("frame_files_missing", count=np.int64(3))
    assert word(found).what.startswith("3 frame files")
    assert json.loads(json.dumps(found.as_dict()))["values"] == {"count": 3}


def test_a_summary_ends_with_ok_or_with_where_to_look():
    assert summarise([LEGS]) == ["OK"]
    size = diagnostic("stature_solved", reason="measured", size=1.4, stature=0.0, percent=1.5)
    (line,) = summarise([LEGS, size])
    assert line.startswith("OK. The solved body is 1.400 m tall (± 1.5 %), if the scale of the calibration is correct")
    assert summarise([TALL, size])[-1].startswith(
        "Look at the whole take (1 warning above). The solved body is 1.400 m"
    )
    other = {"reason": "contradicted", "size": 1.7, "stature": 1.9, "percent": 1.5}
    contradicted = diagnostic("stature_solved", severity=Severity.WARNING, **other)
    assert summarise([contradicted])[-1].endswith("The solved body is 1.700 m tall, but 1.900 m was specified.")
    lines = summarise([LEGS, FAR, TALL, diagnostic("camera_disagrees", cameras=["b"], size=9.0, usual=2.0)], 10.0)
    assert [line.split(":")[0] for line in lines[:-1]] == ["warning"] * 3
    assert "frames 3-9 (0.70 s), frame 12" in lines[0] and "5.78 m tall" in lines[1]
    assert lines[-1] == "Look at camera b; frames 3-9, frame 12; the whole take (1 warning above)."


def test_a_code_that_the_table_lacks_is_a_defect():
    with pytest.raises(KeyError):
        diagnostic("no_such_code")


def test_every_code_is_used_and_every_use_has_its_row():
    root = Path(__file__).resolve().parents[2]
    every = (path for half in ("solver_backend", "blender_addon") for path in sorted((root / half).rglob("*.py")))
    text = "".join(path.read_text(encoding="utf-8") for path in every)
    direct = set(re.findall(r'\bdiagnostic\(\s*"(\w+)"', text))
    assert direct <= set(load_table()), "codes without a row"
    unused = set(load_table()) - set(re.findall(r'"(\w+)"', text))
    assert not unused


def test_a_stated_stature_is_not_asked_for() -> None:
    stated = diagnostic("cameras_scale", source="stature", stature=1.8, percent=1.0)
    assert "1.8 m" in sentence(stated) and "--stature" not in sentence(stated)
    assert "--stature" in sentence(diagnostic("cameras_stature_unknown", percent=10.0))
