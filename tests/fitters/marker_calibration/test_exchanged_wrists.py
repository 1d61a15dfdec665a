"""The inner and the outer marker of a wrist under each other's names, by the bend of the elbow."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from solver_backend.body.markers import marker_layout
from solver_backend.cli.describe_markers import describe_person
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.marker_calibration.label_evidence import exchanged_wrists
from solver_backend.fitters.marker_calibration.label_faults import with_wrists_named
from solver_backend.fitters.marker_calibration.person_doubts import doubts_of, exchanged_in
from solver_backend.fitters.pipeline import calibrate_person, solve
from solver_backend.geometry.rotations import exp_so3
from solver_backend.types import Capture, MarkerCloud, MarkerSubject
from tests.support.words import words
from tests.support.worn_markers import worn_markers

PLACES = ("LSHO", "LELB", "LWRA", "LWRB")


def arm(turned_deg: float, bent_deg: float, swung: float = 1.2, frames: int = 30) -> np.ndarray:
    """Return a left arm's markers: it swings, the forearm is bent to the front and turned about itself."""
    bent, turned = np.radians([bent_deg, turned_deg])
    forearm = np.array([0.0, np.sin(bent), -np.cos(bent)])
    up = np.array([0.0, np.cos(bent), np.sin(bent)])
    thumb = exp_so3(turned * forearm) @ up
    wrist = 0.26 * forearm
    markers = np.stack([(0.0, 0.0, 0.3), np.zeros(3), wrist + 0.03 * thumb, wrist - 0.03 * thumb])
    return markers @ exp_so3(np.linspace(-swung, swung, frames)[:, None] * [1.0, 0.0, 0.0])


@pytest.mark.parametrize("turned", [-70.0, -30.0, 0.0, 30.0, 70.0])
@pytest.mark.parametrize("bent", [30.0, 90.0, 130.0])
def test_the_thumbs_side_is_towards_the_upper_arm_however_the_hand_turns(turned, bent):
    points = arm(turned, bent)
    assert exchanged_wrists(points, PLACES) == []
    assert exchanged_wrists(points[:, [0, 1, 3, 2]], PLACES) == [(2, 3)]


def test_straight_arms_and_one_turned_pose_do_not_show_it():
    order = [0, 1, 3, 2]
    assert exchanged_wrists(arm(0.0, 10.0)[:, order], PLACES) == []
    assert exchanged_wrists(arm(60.0, 90.0, swung=0.0)[:, order], PLACES) == []
    assert exchanged_wrists(arm(0.0, 90.0)[:, order[1:]], PLACES[1:]) == []


@pytest.fixture(scope="module")
def walk() -> MarkerCloud:
    return worn_markers(marker_layout("CMU_41"), 60, fps=30.0, step=2).cloud


def swapped(cloud: MarkerCloud, side: str) -> MarkerCloud:
    names = {f"{side}WRA": f"{side}WRB", f"{side}WRB": f"{side}WRA"}
    return replace(cloud, labels=tuple(names.get(label, label) for label in cloud.labels or ()))


@pytest.mark.slow
def test_a_solve_exchanges_them_and_says_so(walk):
    settings = SolveSettings(iterations=2)
    alone = solve(Capture("walk", markers=walk), settings).motion
    found = solve(Capture("walk", markers=swapped(walk, "L")), settings).motion
    assert np.linalg.norm(found.joints - alone.joints, axis=-1).max() < 0.02
    said = [item for item in found.provenance["diagnostics"] if item["code"] == "markers_exchanged"]
    assert [item["where"]["markers"] for item in said] == [["LWRA", "LWRB"]]


def test_takes_of_a_person_are_named_each_by_itself_and_assigned_names_stay(walk):
    named = with_wrists_named([walk, swapped(walk, "L")], {})
    assert [(c.take, c.first, c.second, c.mended) for c in named.changes] == [(1, "LWRA", "LWRB", True)]
    assert named.clouds[1].labels == walk.labels
    assert with_wrists_named([swapped(walk, "L")], {"LWRA": "LWRA"}).changes == ()


def test_what_a_calibration_exchanges_and_an_odd_shape_are_said():
    empty = np.zeros((0, 3))
    swapped = {"take": 2, "labels": ["C7", "T4"], "corrected": True}
    open_case = {"take": 3, "labels": ["LSHO"], "corrected": False}
    record = {"exchanged": [["LWRA", "LWRB"]], "names_over_takes": [swapped, open_case]}
    person = MarkerSubject("neutral", np.zeros(10), (), (), empty, empty[:, 0], empty[:, 0], record)
    codes = ["markers_exchanged", "names_exchanged_in_takes", "names_differ_between_takes"]
    said = [*exchanged_in(person), *doubts_of(person)]
    assert [item.code for item in said] == codes
    assert "C7 and T4 in take 2" in words(said)[1] and "LSHO in take 3" in words(said)[2]
    _, data = describe_person(replace(person, betas=np.full(10, 6.5)))
    assert [item["code"] for item in data["diagnostics"]] == [*codes, "shape_odd"]


@pytest.mark.slow
def test_a_calibration_of_one_take_says_so(walk):
    person = calibrate_person([Capture("walk", markers=swapped(walk, "L"))], SolveSettings(iterations=1))
    (doubt,) = doubts_of(person)
    assert doubt.code == "names_exchanged_in_takes" and set(doubt.where.markers) == {"LWRA", "LWRB"}


@pytest.mark.parametrize(
    ("name", "side"),
    [("m02_s03_e02", "L"), ("m02_s03_e02_inc", "L"), ("m10_s05_e02", "R"), ("m04_s03_e02", ""), ("m05_s05_e02", "")],
)
def test_real_takes(shared_data: Path, name: str, side: str):
    """Three files of UI-PRMD have them exchanged."""
    with np.load(shared_data / "markers" / "ui_prmd" / f"{name}.npz", allow_pickle=False) as data:
        points, labels = 1e-4 * data["positions_01mm"].astype(float), tuple(map(str, data["labels"]))
    found = exchanged_wrists(points, labels)
    assert [labels[a] for a, _ in found] == [f"{side}WRA"] * bool(side)
