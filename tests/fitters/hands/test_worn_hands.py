"""Markers of hands beside a body's: split off by their labels, and solved with the wrist that the body has."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.body.hand_markers import hand_markers, hand_place
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.body.label_places import places_given
from solver_backend.body.markers import marker_layout
from solver_backend.exchange.body_layout import SMPL_HANDS
from solver_backend.fitters.hands.shown_hands import split_hands
from solver_backend.fitters.label_after import labelled_like
from solver_backend.fitters.pipeline import calibrate_person, solve
from solver_backend.geometry.rotations import exp_so3
from solver_backend.synthesis.embedded.demo import demo_capture
from solver_backend.synthesis.simulation.cast import Person
from solver_backend.synthesis.studio.person_hands import MovingHands, move_hands
from solver_backend.types import Capture, MarkerCloud, Motion
from tests.support.lone_marker_hand import LAYOUTS
from tests.support.worn_markers import worn_markers

FRAMES, FPS = 40, 60.0


def cloud_of(*names: str) -> MarkerCloud:
    return MarkerCloud(np.zeros((3, len(names), 3)), FPS, names)


def test_labels_of_hands_are_split_off_by_side() -> None:
    body, hands = split_hands(cloud_of("LASI", "L_FT1", "left_PP2", "Lmp5", "Ann:RFT1", "RFT2", "right-MP2", "RKNE"))
    assert body.labels == ("LASI", "RKNE")
    assert hands is not None
    assert hands.labels == {0: ("FT1", "PP2", "MP5"), 1: ("FT1", "FT2", "MP2")}


def test_one_label_alone_is_no_hand() -> None:
    cloud = cloud_of("LASI", "LMP1", "RMP5", "LIP")
    assert split_hands(cloud) == (cloud, None)


@dataclass(frozen=True)
class WornTake:
    """Markers of a body and of its hands, and the truth."""

    cloud: MarkerCloud
    hands: MovingHands
    of_body: tuple[str, ...]
    """Labels of the body's own."""


def worn_take(layout: str, seed: int = 4, frames: int = FRAMES) -> WornTake:
    """Return the demo's body with markers, also on both hands, whose fingers move."""
    labels = marker_layout("PLUGIN_GAIT_39")
    worn = worn_markers(labels, frames, fps=FPS, stray_m=0.004)
    truth, body = demo_capture().truth, load_body()
    part = slice(0, frames)
    local = exp_so3(truth["body_pose"][part, :63].reshape(-1, 21, 3))
    person = Person(body, truth["betas"], exp_so3(truth["global_orient"][part]), local, truth["transl"][part])
    hands = move_hands(person, FPS, np.random.default_rng(seed))
    posed = forward_kinematics(body, person.betas, person.orient, person.local, person.transl)
    positions, names, wrist = [worn.cloud.positions], list(labels), body.layout.joints.index("left_wrist")
    for side, letter in enumerate("LR"):
        markers, skeleton = hand_markers(hands.skeletons[side], LAYOUTS[layout]), hands.skeletons[side]
        own = skeleton.sites(skeleton.pose(hands.angles[:, side]), markers.sites)
        G, place = posed.G[:, None, wrist + side], posed.joints[:, None, wrist + side]
        positions.append(place + (G @ own[..., None])[..., 0])
        names += [f"{letter}{label}" for label in markers.labels]
    return WornTake(MarkerCloud(np.concatenate(positions, axis=1), FPS, tuple(names)), hands, tuple(labels))


def error_mm(motion: Motion, hands: MovingHands, joint: str = "index2", point: int = 6) -> np.ndarray:
    """Return (F, 2) millimetres by which a joint of both hands is off."""
    columns = [SMPL_HANDS.joints.index(f"{side}_{joint}") for side in ("left", "right")]
    return 1000 * np.linalg.norm(motion.joints[:, columns] - hands.points[:, :, point], axis=-1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("layout", "largest_mm"), [("hand26", 12.0), ("hand10", 16.0), ("hand5", 30.0), ("hand3", 30.0)]
)
def test_fingers_come_with_the_body(layout: str, largest_mm: float) -> None:
    take = worn_take(layout)
    motion = solve(Capture("worn", markers=take.cloud)).motion
    assert motion.body_layout.joints == SMPL_HANDS.joints
    assert set(motion.marker_labels or ()) <= set(take.of_body) and motion.marker_labels
    assert error_mm(motion, take.hands).mean() < largest_mm


def renamed(cloud: MarkerCloud, labels: dict[str, str]) -> MarkerCloud:
    return replace(cloud, labels=tuple(labels.get(label, label) for label in cloud.labels or ()))


@pytest.mark.slow
def test_markers_without_a_place_are_attached_to_the_finger_that_they_move_with() -> None:
    take = worn_take("hand10")
    body, hands = split_hands(renamed(take.cloud, {"LPP2": "spare", "RFT4": "blue"}))
    assert set(body.labels or ()) == set(take.of_body)
    assert hands is not None and hands.extra_labels == {0: ("spare",), 1: ("blue",)}
    motion = solve(Capture("worn", markers=renamed(take.cloud, {"LPP2": "spare", "RFT4": "blue"}))).motion
    assert "hand_markers_left_out" not in [row["code"] for row in motion.provenance.get("diagnostics", ())]
    # The tip of the ring finger, of which nothing else is measured beyond the knuckle but PP4.
    columns = [SMPL_HANDS.joints.index("left_index3"), SMPL_HANDS.joints.index("right_ring3")]
    truth = np.stack([take.hands.points[:, 0, 7], take.hands.points[:, 1, 15]], axis=1)
    with_them = 1000 * np.linalg.norm(motion.joints[:, columns] - truth, axis=-1).mean(0)
    named = solve(Capture("worn", markers=take.cloud)).motion
    best = 1000 * np.linalg.norm(named.joints[:, columns] - truth, axis=-1).mean(0)
    assert (with_them < best + 4.0).all()


@pytest.mark.slow
def test_markers_that_move_with_no_segment_are_named() -> None:
    take = worn_take("hand10")
    positions = np.asarray(take.cloud.positions).copy()
    labels = list(take.cloud.labels or ())
    tip, knuckle = positions[:, labels.index("LFT2")], positions[:, labels.index("LMP2")]
    share = (0.5 + 0.5 * np.sin(np.arange(FRAMES)))[:, None]
    slides = (1 - share) * tip + share * knuckle
    cloud = MarkerCloud(np.concatenate([positions, slides[:, None]], axis=1), FPS, (*labels, "slides"))
    motion = solve(Capture("worn", markers=cloud)).motion
    [left] = [row for row in motion.provenance["diagnostics"] if row["code"] == "hand_markers_left_out"]
    assert left["where"]["markers"] == ["slides"]
    assert error_mm(motion, take.hands).mean() < 16.0


def test_a_layout_of_ones_own_names_places_of_hands(tmp_path: Path) -> None:
    take = worn_take("hand5")
    names = {f"{side}{place}": f"{side}x{number}" for side in "LR" for number, place in enumerate(LAYOUTS["hand5"])}
    path = tmp_path / "places.json"
    places = {own: label for label, own in names.items()}
    path.write_text(json.dumps({"format": "manifold_mocap_labels", "version": 1, "places": places}))
    own = places_given(str(path))
    body, hands = split_hands(renamed(take.cloud, names), own)
    assert hands is not None and hands.labels == {0: LAYOUTS["hand5"], 1: LAYOUTS["hand5"]}
    assert set(body.labels or ()) == set(take.of_body)


@pytest.mark.slow
def test_a_calibrated_person_wears_no_markers_of_hands() -> None:
    take = worn_take("hand10")
    person = calibrate_person([Capture("worn", markers=take.cloud)])
    assert set(person.labels) <= set(take.of_body)


@pytest.mark.slow
@pytest.mark.parametrize("layout", ["hand26", "hand10"])
def test_points_are_named_after_a_take_with_hands(layout: str) -> None:
    # Five seconds in which fingers move show which distances stay; one second does not, and neighbours are exchanged.
    like, take = worn_take(layout, frames=300), worn_take(layout, seed=9)
    order = np.random.default_rng(1).permutation(len(take.cloud.labels or ()))
    truth = [(take.cloud.labels or ())[i] for i in order]
    points = MarkerCloud(np.asarray(take.cloud.positions)[:, order], FPS, tuple(f"*{i}" for i in range(len(order))))
    _, found = labelled_like(Capture("points", markers=points), Capture("like", markers=like.cloud))
    named = np.array([*(like.cloud.labels or ()), ""])[found.point_labels]
    of_hand = np.array([hand_place(label) is not None for label in truth])
    right = named == np.array(truth)
    wrong = (named != "") & ~right
    assert right[:, of_hand].mean() > 0.97 and not wrong.any()
