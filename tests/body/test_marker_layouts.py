"""Labels of other systems find their places; computed points and unknown labels are told apart."""

from __future__ import annotations

import json

import pytest

from solver_backend.body.marker_layouts import DEFAULT, load_layouts
from solver_backend.body.marker_names import name_markers
from solver_backend.exchange.errors import FileDamaged


@pytest.mark.parametrize("name", ["CMU_41", "PLUGIN_GAIT_39", "MANIFOLD_53"])
def test_layouts_of_ours_are_known(name):
    names = name_markers(load_layouts().layouts[name])
    assert len(names.known) == len(load_layouts().layouts[name])
    assert not (names.unknown or names.virtual or names.doubled)


@pytest.mark.parametrize("name", ["OPTITRACK_BASELINE", "HELEN_HAYES", "IOR", "OPENSIM"])
def test_layouts_of_other_systems_are_known(name):
    labels = load_layouts().label_sets[name]
    assert list(name_markers([f"Anna:{label}" for label in labels]).known) == [f"Anna:{label}" for label in labels]


@pytest.mark.parametrize(
    ("label", "place"),
    [
        ("LASI", "LFWT"), ("Anna:lasi", "LFWT"), ("L.ASIS", "LFWT"), ("r_knee", "RKNE"), ("L_elbow_lat", "LELB"),
        ("ASIS.L", "LFWT"), ("Left ASIS", "LFWT"), ("HeelRight", "RHEE"), ("WaistLBack", "LBWT"), ("R_FLE", "RKNE"),
        ("r_mankle", "RANM"), ("L_wrist_radius", "LWRA"), ("V.Sacral", "SACR"), ("Rear.Head", "HEADB"),
        ("RTIB", "RSHN"), ("RBAK", "RBAC"), ("L_5meta", "LMT5"),
        ("heel", None), ("r_thigh3", None), ("LASI (2)", None), ("*7", None), ("", None),
    ],
)  # fmt: skip
def test_a_label_names_its_place(label, place):
    assert load_layouts().place_of(label) == place


@pytest.mark.parametrize("label", ["L_HJC", "L_HJC_reg", "Anna:RKJC", "HEDO", "LFEP", "PELA", "CentreOfMass", "VRKN"])
def test_computed_points_are_told_from_markers(label):
    names = name_markers([label, "LTIB", "x12"])
    assert names.virtual == (label,) and names.unknown == ("x12",) and names.known == {"LTIB": "LSHN"}


def test_plates_are_on_the_bone_that_their_system_names():
    labels = ("LTHPA", "LTHDP", "RSHPA", "RUAPP", "LFADA", "PVUL", "RFTB", "RANL")
    bones = ("@left_hip", "@left_hip", "@right_knee", "@right_shoulder", "@left_elbow", "@pelvis", "@right_ankle")
    assert name_markers(labels).known == dict(zip(labels, (*bones, "RANK"), strict=True))
    assert name_markers(["PVUL", "RFTB"]).unknown == ("PVUL", "RFTB")


def test_of_two_labels_of_one_place_the_first_counts():
    names = name_markers(["LFWT", "C7", "LASI"])
    assert names.known == {"LFWT": "LFWT", "C7": "C7"} and names.doubled == ("LASI",)


def test_a_name_of_two_places_is_refused(tmp_path):
    values = json.loads(DEFAULT.read_text(encoding="utf-8"))
    values["aliases"]["KNE"].append("ASIS")
    path = tmp_path / "layouts.json"
    path.write_text(json.dumps(values), encoding="utf-8")
    with pytest.raises(FileDamaged, match="The name LASIS means both L... and L..."):
        load_layouts(path)
    path.write_text('{"format": "other"}', encoding="utf-8")
    with pytest.raises(FileDamaged, match="is not a manifold_mocap_marker_layouts of version 1.*Correct the file"):
        load_layouts(path)


def test_a_place_of_an_unknown_kind_is_named(tmp_path):
    values = json.loads(DEFAULT.read_text(encoding="utf-8"))
    values["midline"]["C7"]["kind"] = "cartilage"
    path = tmp_path / "layouts.json"
    path.write_text(json.dumps(values), encoding="utf-8")
    with pytest.raises(FileDamaged, match="C7 has the unknown kind 'cartilage'. Known"):
        load_layouts(path)


def test_a_name_of_a_place_without_a_rule_is_refused(tmp_path):
    values = json.loads(DEFAULT.read_text(encoding="utf-8"))
    values["midline"]["T8x"] = values["midline"].pop("T8")
    path = tmp_path / "layouts.json"
    path.write_text(json.dumps(values), encoding="utf-8")
    with pytest.raises(FileDamaged, match="which has no rule"):
        load_layouts(path)
