"""Left and right exchanged in a part of a marker set: refused with what is exchanged, and correct sets pass."""

from __future__ import annotations

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.body.markers import marker_landmarks
from solver_backend.exchange.errors import MarkersMirrored
from solver_backend.fitters.marker_calibration.label_evidence import check_sides
from solver_backend.fitters.model.subject import PosedFrames, Subject, pose
from solver_backend.geometry.rotations import exp_so3
from solver_backend.synthesis.embedded.demo import demo_capture
from tests.support.floor_takes import kneeling
from tests.support.worn_markers import worn_markers

LOWER = ("FWT", "BWT", "THI", "KNE", "SHN", "ANK", "HEE", "TOE", "MT5")
UPPER = ("SHO", "UPA", "ELB", "FRM", "WRA")


def a_take(places: tuple[str, ...]) -> tuple[np.ndarray, tuple[str, ...]]:
    names = tuple(side + place for place in places for side in "LR")
    return worn_markers(names, 24, fps=15.0, step=8).cloud.positions, names


def exchanged(names: tuple[str, ...], places: tuple[str, ...]) -> tuple[str, ...]:
    return tuple({"L": "R", "R": "L"}[name[0]] + name[1:] if name[1:] in places else name for name in names)


@pytest.mark.parametrize(
    ("places", "turned", "message"),
    [
        (LOWER, (), ""), (UPPER, (), ""), (("KNE", "ANK", "HEE", "TOE"), (), ""),
        (LOWER, LOWER, "legs' markers are mirrored"), (LOWER, LOWER[2:], "left markers of the legs are on the right"),
        (UPPER, UPPER[1:], "left markers of the arms are on the right"),
        (LOWER, LOWER[:2], "left markers of the waist are on the right"),
    ],
)  # fmt: skip
def test_sides(places: tuple[str, ...], turned: tuple[str, ...], message: str) -> None:
    points, names = a_take(places)
    landmarks = marker_landmarks(load_body(), exchanged(names, turned))
    points[::7, 1] = np.nan
    if not message:
        check_sides(points, landmarks)
        return
    with pytest.raises(MarkersMirrored, match=message):
        check_sides(points, landmarks)


@pytest.mark.parametrize("exact", [True, False])
def test_legs_that_kneel_with_the_toes_backwards_are_no_mirror_image(exact: bool) -> None:
    names, person, rng = tuple(side + place for place in LOWER for side in "LR"), kneeling(24), np.random.default_rng(2)
    landmarks = marker_landmarks(person.body, names)
    points = person.pose(landmarks).points
    if not exact:
        points = points + 0.01 * rng.normal(size=points.shape[1:])
        points[::3, names.index("RTOE")] = np.nan
    check_sides(points, landmarks)
    with pytest.raises(MarkersMirrored, match="legs' markers are mirrored"):
        check_sides(points * [-1.0, 1.0, 1.0], landmarks)
    with pytest.raises(MarkersMirrored, match="left markers of the legs are on the right"):
        check_sides(points, marker_landmarks(person.body, exchanged(names, LOWER[2:])))


LEG = ("KNE", "SHN", "ANK", "HEE", "TOE")
PELVIS = ("LFWT", "RFWT", "LBWT", "RBWT")


@pytest.mark.parametrize(
    ("kept", "limb", "message"),
    [
        (PELVIS, LEG, "markers of the left leg are on the right of the body"),
        (("LSHO", "RSHO"), UPPER[1:], "markers of the left arm"),
        ((), LEG, "outer ankle of the left leg is on the inner side"),
    ],
)  # fmt: skip
def test_one_limb_named_as_the_other_sides(kept: tuple[str, ...], limb: tuple[str, ...], message: str) -> None:
    right = tuple("R" + place for place in limb)
    points = worn_markers((*kept, *right), 24, fps=15.0, step=8).cloud.positions
    check_sides(points, marker_landmarks(load_body(), (*kept, *right)))
    with pytest.raises(MarkersMirrored, match=message):
        check_sides(points, marker_landmarks(load_body(), (*kept, *("L" + place for place in limb))))


def test_a_heel_and_toes_that_have_each_others_labels_are_no_other_leg() -> None:
    names = tuple("R" + place for place in LEG)
    points = worn_markers(names, 24, fps=15.0, step=8).cloud.positions
    for a, b in (("HEE", "TOE"), ("ANK", "HEE")):
        turned = tuple({"R" + a: "R" + b, "R" + b: "R" + a}.get(name, name) for name in names)
        check_sides(points, marker_landmarks(load_body(), turned))


CENTRES = tuple(
    f"={side}_{part}"
    for part in ("hip", "knee", "ankle", "foot", "shoulder", "elbow", "wrist")
    for side in ("left", "right")
)


@pytest.mark.parametrize(
    "places",
    [
        CENTRES, tuple(place for place in CENTRES if "foot" not in place),
        ("~nose", "~neck", *("~" + place[1:] for place in CENTRES[8:])),
    ],
    ids=["suit", "without toes", "upper body"],
)  # fmt: skip
def test_joint_centres_in_left_handed_axes(places: tuple[str, ...]) -> None:
    """As Unity and Unreal write them."""
    landmarks, truth = marker_landmarks(load_body(), places), demo_capture().truth
    subject = Subject(load_body(), landmarks, truth["betas"], np.zeros((len(places), 3)))
    chosen = slice(0, 192, 8)
    local = exp_so3(truth["body_pose"][chosen, :63].reshape(-1, 21, 3))
    points = pose(subject, PosedFrames(exp_so3(truth["global_orient"][chosen]), local, truth["transl"][chosen])).points
    check_sides(points, landmarks)
    with pytest.raises(MarkersMirrored, match="joint centres are mirrored"):
        check_sides(points * [-1.0, 1.0, 1.0], landmarks)
