"""A layout of one's own: saved, edited, read, and refused where it makes no sense."""

from __future__ import annotations

import json

import pytest

from solver_backend.body.label_places import read_label_places, write_label_places
from solver_backend.body.marker_names import name_markers
from solver_backend.exchange.errors import FileDamaged, FileMissing, MarkersUnknown, OutputExists

LABELS = ("Anna:LASI", "knee left", "armband", "L_HJC", "*12", "LFWT")


def test_a_layout_is_saved_edited_and_read(tmp_path):
    path = write_label_places(tmp_path / "mine.json", LABELS)
    values = json.loads(path.read_text(encoding="utf-8"))
    assert values["places"] == {
        "Anna:LASI": "LFWT", "knee left": "LKNE", "armband": None, "L_HJC": "", "LFWT": ""
    }  # fmt: skip
    values["places"] |= {"armband": "@left_elbow", "knee left": "", "Anna:LASI": "RASI"}
    path.write_text(json.dumps(values), encoding="utf-8")
    own = read_label_places(path)
    assert own == {"armband": "@left_elbow", "knee left": "", "Anna:LASI": "RFWT", "L_HJC": "", "LFWT": ""}
    names = name_markers([label for label in LABELS if label != "*12"], own)
    assert names.known == {"Anna:LASI": "RFWT", "armband": "@left_elbow"}
    assert set(names.virtual) == {"knee left", "L_HJC", "LFWT"} and not names.unknown


def test_many_markers_may_be_on_one_bone():
    own = {"a": "@head", "b": "@head", "c": "LKNE", "d": "LKNE"}
    names = name_markers(list(own), own)
    assert names.known == {"a": "@head", "b": "@head", "c": "LKNE"} and names.doubled == ("d",)


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("{", FileDamaged),
        ("[]", FileDamaged),
        ('{"format": "manifold_mocap_labels", "version": 9, "places": {}}', FileDamaged),
        ('{"format": "manifold_mocap_labels", "version": 1, "places": {"a": 3}}', FileDamaged),
        ('{"format": "manifold_mocap_labels", "version": 1, "places": {"a": "@wing"}}', MarkersUnknown),
        ('{"format": "manifold_mocap_labels", "version": 1, "places": {"a": "nowhere"}}', MarkersUnknown),
    ],
)
def test_what_is_no_layout_is_named(tmp_path, text, error):
    path = tmp_path / "bad.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(error):
        read_label_places(path)


def test_nothing_is_overwritten_or_made_up(tmp_path):
    path = write_label_places(tmp_path / "mine.json", LABELS)
    with pytest.raises(OutputExists):
        write_label_places(path, LABELS)
    with pytest.raises(FileMissing):
        read_label_places(tmp_path / "none.json")


def test_labels_of_hands_are_written_with_their_places(tmp_path):
    hands = ("LFT1", "LFT2", "left_MP5")
    path = write_label_places(tmp_path / "hands.json", (*LABELS, *hands, "RFT1"))
    found = read_label_places(path)
    assert [found[label] for label in hands] == ["L_FT1", "L_FT2", "L_MP5"] and "RFT1" not in found
