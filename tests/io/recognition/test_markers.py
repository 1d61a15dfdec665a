"""What a file of markers says without saying it: names, unit, up-axis."""

from __future__ import annotations

import numpy as np
import pytest

from solver_backend.geometry.rotations import exp_so3
from solver_backend.io.recognition.marker_labels import (
    is_model_output,
    is_unnamed,
    prefix_of,
    subjects_of,
    unique_labels,
)
from solver_backend.io.recognition.marker_up_axis import find_unit, find_up_axis
from solver_backend.io.units_and_axes import METRES, UP_AXES, rotation_to_z_up, unit_named

BODY = {"LFHD": 1.7, "RSHO": 1.4, "C7": 1.5, "LASI": 1.0, "LKNE": 0.5, "LANK": 0.08, "RTOE": 0.03}
"""Heights of markers in metres."""


def standing(frames: int = 30) -> np.ndarray:
    rng = np.random.default_rng(2)
    walk = np.linspace(-1.5, 1.5, frames)[:, None]
    points = np.zeros((frames, len(BODY), 3))
    points[..., 0] = walk + rng.normal(0, 0.1, len(BODY))
    points[..., 1] = rng.normal(0, 0.1, len(BODY))
    points[..., 2] = list(BODY.values())
    return points


def test_labels() -> None:
    assert prefix_of("Ann:Left:LASI") == "Ann:Left"
    assert prefix_of("LASI") == ""
    assert subjects_of(("Bob:A", "Ann:B", "Bob:C", "D", "Cy:*3", "Di:Unlabeled 7")) == ("Bob", "Ann")
    assert all(map(is_unnamed, ("", "*", "*12", "A:*1", "Unlabeled 1189", "unlabelled_3", "U_12", "u7", "New 0012")))
    assert not any(map(is_unnamed, ("LASI", "T10", "U", "New", "A:M1", "*a", "1")))
    assert all(map(is_model_output, ("LHipAngles", "Ann:RKneeMoment", "LGroundReactionForce", "LAnklePower")))
    assert not any(map(is_model_output, ("LASI", "Angles", "LANG", "POWER", "R_angle_1")))
    assert unique_labels(("A", "", "A", "A (2)", "A", "*2")) == (
        ("A", "*2 (2)", "A (3)", "A (2)", "A (4)", "*2"),
        ("A",),
    )


def test_many_equal_labels_are_no_long_work() -> None:
    labels, doubled = unique_labels(("A",) * 65535)
    assert (labels[-1], doubled) == ("A (65535)", ("A",))


def test_units() -> None:
    names = {"mm": "mm", "Millimeters": "mm", " MM ": "mm", "cm": "cm", "Centimeters": "cm", "m": "m", "Meters": "m"}
    names |= {"mete": "m", "Inches": "inch", "feet": "foot", "ft": "foot"}
    assert {text: unit_named(text) for text in names} == names
    assert [unit_named(text) for text in ("", "deg", "N.mm", "?")] == [None] * 4
    body = standing()
    for unit, metres in (("mm", 1e-3), ("cm", 1e-2), ("m", 1.0)):
        for default in ("mm", "m"):
            assert find_unit(body / metres, "", None, default).name == unit
            wrong = {"mm": "m", "m": "mm"}.get(unit)
            if wrong:
                found = find_unit(body / metres, wrong, None, default)
                assert found.name == unit
                assert found.problem is not None and found.problem.code == "marker_unit_not_as_stated"
                assert found.problem.values["stated"] == wrong
    for metres, unit in ((1.0, "m"), (0.001, "mm")):  # a toddler who sits
        assert find_unit(0.2 * body / metres, "", None, unit).name == unit
    lost = find_unit(body * 1e9, "m", None, "mm")
    assert lost.problem is not None
    assert (lost.name, lost.problem.code) == ("m", "marker_spread_unlikely")
    assert find_unit(body * 1e9, "", None, "mm").note.code == "unit_read"


@pytest.mark.parametrize("axis", UP_AXES)
@pytest.mark.parametrize("default", ["z", "y"])
@pytest.mark.parametrize("named", [True, False])
def test_up_axis_by_how_the_body_stands(axis: str, default: str, named: bool) -> None:
    rotated = standing() @ rotation_to_z_up(axis)
    labels = tuple(BODY) if named else tuple(f"M{i}" for i in range(len(BODY)))
    found = find_up_axis(rotated, labels, "", None, default)
    assert (found.name, found.note.code, found.problem) == (axis, "up_axis_read", None)


def test_who_may_lie_along_an_unusual_axis_is_doubted() -> None:
    """On a couch: long along x, whose 0 is anywhere."""
    lying = (standing() - [0.0, 0.0, 0.9]) @ rotation_to_z_up("x") + [0.0, 0.0, 0.75]
    found = find_up_axis(lying, tuple(BODY), "", None, "z")
    assert (found.name, found.problem and found.problem.code) == ("x", "up_axis_doubted")
    assert find_up_axis(standing() @ rotation_to_z_up("x"), tuple(BODY), "", None, "z").problem is None


def test_a_person_who_lies_on_an_inaccurate_floor_keeps_the_axis() -> None:
    lying = standing() @ np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    lying = np.stack([lying[..., 0] - 0.1, lying[..., 1], 0.05 * lying[..., 2] + 0.05], axis=-1)
    for lowest in (0.01, -0.04):
        heights = lying - [0.0, 0.0, np.quantile(lying[..., 2], 0.01) - lowest]
        assert find_up_axis(heights, tuple(BODY), "", None, "z").name == "z"


def test_up_axis_of_what_says_none() -> None:
    ball = np.random.default_rng(1).uniform(-1, 1, (20, 9, 3))
    for default in ("z", "y"):
        found = find_up_axis(ball, ("A",) * 9, "", None, default)
        assert (found.name, found.note.code) == (default, "up_axis_read")
    above = np.abs(ball) + [-3, -3, 0.02]
    assert find_up_axis(above, ("A",) * 9, "", None, "y").name == "z"


LEGS = ("LASI", "RPSI", "LKNE", "LANK", "RTOE")


@pytest.mark.parametrize("labels", [LEGS, LEGS[2:]], ids=["pelvis and legs", "legs"])
@pytest.mark.parametrize("axis", ["y", "z", "x"])
def test_up_axis_of_legs_away_from_any_floor(labels: tuple[str, ...], axis: str) -> None:
    """Positions relative to the hips, as exports of limbs have them."""
    heights = {"LASI": 0.0, "RPSI": 0.02, "LKNE": -0.5, "LANK": -0.9, "RTOE": -0.95}
    points = np.random.default_rng(4).normal(0, 0.05, (20, len(labels), 3))
    points[..., 2] += [heights[label] for label in labels]
    found = find_up_axis(points @ rotation_to_z_up(axis), labels, "", None, "y")
    assert (found.name, found.note.code) == (axis, "up_axis_read")


@pytest.mark.parametrize("labels", [("LFHD", "RFHD", "T10"), ("C7", "LSHO", "STRN")], ids=["head", "shoulders"])
@pytest.mark.parametrize("axis", ["y", "z", "x"])
def test_up_axis_of_an_upper_body_whose_arms_are_spread(labels: tuple[str, ...], axis: str) -> None:
    """The box around it is longest across, and one hand is at the origin."""
    heights = {"LFHD": 1.65, "RFHD": 1.65, "C7": 1.48, "LSHO": 1.43, "STRN": 1.2, "T10": 1.2}
    arms = ("LUPA", "LELB", "LWRA", "RUPA", "RELB", "RWRA")
    points = np.random.default_rng(4).normal(0, 0.03, (20, len(labels) + 6, 3))
    points[:, : len(labels), 2] += [heights[label] for label in labels]
    points[:, len(labels) :, 2] += 1.4
    points[..., 0] += [*([0.8] * len(labels)), 1.0, 1.3, 1.6, 0.6, 0.3, 0.0]
    found = find_up_axis(points @ rotation_to_z_up(axis), (*labels, *arms), "", None, "y")
    assert (found.name, found.note.code) == (axis, "up_axis_read")


def test_up_axis_of_joint_centres_in_a_cameras_axes() -> None:
    """Y down, half a metre below the camera: nothing speaks for the usual axis."""
    names = ("Nose", "LShoulder", "LHip", "LKnee", "LAnkle")
    points = np.random.default_rng(4).normal(0, 0.05, (20, len(names), 3))
    points[..., 2] += [1.6, 1.4, 0.9, 0.5, 0.1]
    camera = (points - [0.0, 0.0, 2.2]) @ rotation_to_z_up("-y")
    assert find_up_axis(camera, names, "", None, "y").name == "-y"
    down = exp_so3(np.array([np.radians(30.0), 0.0, 0.0]))
    assert find_up_axis(camera @ down.T, names, "", None, "y").name == "-y"
    handstand = points * [1.0, 1.0, -1.0] + [0.0, 0.0, 1.8]
    found = find_up_axis(handstand @ rotation_to_z_up("y"), names, "", None, "y")
    assert (found.name, found.problem and found.problem.code) == ("y", "up_axis_doubted")


@pytest.mark.parametrize("axis", ["y", "z", "x"])
def test_parts_that_are_no_persons_distance_apart_name_no_axis(axis: str) -> None:
    """A shoe and a hat at the two ends of a room, beside somebody whose markers have names of their own."""
    body = standing()
    props = np.zeros((len(body), 2, 3)) + [[-3.0, 0.0, 0.4], [5.0, 0.0, 0.5]]
    labels = (*[f"M{i}" for i in range(body.shape[1])], "TOE", "HEAD")
    found = find_up_axis(np.concatenate([body, props], 1) @ rotation_to_z_up(axis), labels, "", None, axis)
    assert (found.name, found.problem) == (axis, None)


@pytest.mark.parametrize(("unit", "stated"), [("inch", ""), ("cm", "mm"), ("foot", ""), ("mm", "cm"), ("m", "mm")])
def test_a_unit_by_how_far_parts_of_a_body_are_apart(unit: str, stated: str) -> None:
    """51 inches from head to feet are half a metre in centimetres, which markers of legs could be."""
    body = standing() / METRES[unit]
    found = find_unit(body, stated, None, "mm", tuple(BODY))
    assert found.name == unit and (found.problem is not None) == bool(stated)
    legs = [i for i, label in enumerate(BODY) if label in ("LASI", "LKNE", "LANK", "RTOE")]
    assert find_unit(body[:, legs], stated, None, "mm", [list(BODY)[i] for i in legs]).name == unit
    assert find_unit(standing(), "m", None, "mm", tuple(BODY)).problem is None
