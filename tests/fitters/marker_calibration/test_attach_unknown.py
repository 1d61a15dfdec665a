"""Markers of unknown name: attached to the bone that they move with, or to none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.body.markers import ON_BONE, marker_layout
from solver_backend.fitters.marker_calibration.unknown_markers import BonePoses, attach, common_bones
from solver_backend.fitters.pipeline import calibrate_person
from solver_backend.geometry.rotations import exp_so3
from solver_backend.types import SMPL_JOINTS, Capture, MarkerCloud
from tests.support.worn_markers import worn_markers

pytestmark = pytest.mark.slow  # Making what these tests look at takes 4 to 14 seconds of CPU time.

LABELS = marker_layout("CMU_41")
RENAMED = {"LSHN": "thing 1", "RFRM": "thing 2", "LFHD": "thing 3", "RFWT": "thing 4"}
BONES = {"thing 1": {"left_knee"}, "thing 2": {"right_elbow"}, "thing 3": {"head", "neck"}, "thing 4": {"pelvis"}}


@pytest.fixture(scope="module")
def person():
    cloud = worn_markers(LABELS, 60, fps=15.0, step=4).cloud
    wand = np.cumsum(0.02 * np.random.default_rng(1).normal(size=(60, 1, 3)), axis=0) + (0.0, 0.0, 1.0)
    points = np.concatenate([cloud.positions, wand, cloud.positions[:, :1] + 0.01], axis=1)
    labels = (*(RENAMED.get(label, label) for label in LABELS), "wand", "*47")
    return calibrate_person([Capture("take", markers=MarkerCloud(points, 15.0, labels))])


def test_each_finds_its_bone(person):
    places = dict(zip(person.labels, person.places, strict=True))
    for label, bones in BONES.items():
        assert places[label] in {ON_BONE + bone for bone in bones}, label
    assert "wand" not in places and "*47" not in places
    assert len(person.labels) == len(LABELS)
    attached = [i for i, place in enumerate(person.places) if place.startswith(ON_BONE)]
    assert np.isnan(person.skin_m[attached]).all() and (person.sigma_m[attached] < 0.02).all()


def test_the_bone_with_the_steadiest_offset_wins():
    rng = np.random.default_rng(4)
    joints = 0.3 * rng.normal(size=(40, 24, 3))
    rotations = exp_so3(rng.normal(size=(40, 24, 3)))
    bones = BonePoses(joints, rotations)
    knee, offset = SMPL_JOINTS.index("left_knee"), np.array([0.05, -0.1, 0.08])
    points = joints[:, knee] + rotations[:, knee] @ offset + 0.002 * rng.normal(size=(40, 3))
    found = attach(points, bones)
    assert found is not None and found.place == "@left_knee"
    np.testing.assert_allclose(found.offset, offset, atol=0.002)
    assert found.sigma_m == pytest.approx(0.002, rel=0.3)
    few = points.copy()
    few[5:] = np.nan
    assert attach(few, bones) is None
    assert attach(rng.normal(size=(40, 3)), bones) is None


def test_takes_may_lack_some_of_the_markers():
    cloud = worn_markers(LABELS, 60, fps=15.0, step=4).cloud
    parts = [
        replace(cloud, positions=cloud.positions[:30, :-1], labels=LABELS[:-1]),
        replace(cloud, positions=cloud.positions[30:, 1:], labels=LABELS[1:]),
    ]
    person = calibrate_person([Capture(str(i), markers=part) for i, part in enumerate(parts)])
    assert set(person.labels) == set(LABELS)


def test_a_label_that_names_a_bone_is_on_that_one():
    rng = np.random.default_rng(2)
    joints = np.cumsum(0.01 * rng.normal(size=(20, 24, 3)), axis=0)
    turns = exp_so3(0.3 * rng.normal(size=(20, 24, 3)))
    elbow, shoulder = SMPL_JOINTS.index("left_elbow"), SMPL_JOINTS.index("left_shoulder")
    joints[:, elbow] = joints[:, shoulder] + turns[:, shoulder] @ [0.25, 0.0, 0.0]
    turns[:, elbow] = turns[:, shoulder]  # an arm that is kept straight
    points = joints[:, elbow] - turns[:, shoulder] @ [0.05, 0.0, 0.02]
    bones = BonePoses(joints, turns)
    found, named = attach(points, bones), attach(points, bones, "left_shoulder")
    assert found is not None and found.place == ON_BONE + "left_elbow"
    assert named is not None and named.place == ON_BONE + "left_shoulder"
    assert attach(points, bones, "right_hip") is None


def test_a_plate_is_on_the_bone_of_its_known_marker_or_on_one_bone():
    """The spine turns nearly like the pelvis, so that each marker alone is as steady there."""
    rng = np.random.default_rng(3)
    joints = np.cumsum(0.02 * rng.normal(size=(60, 1, 3)), axis=0) + 0.3 * rng.normal(size=(24, 3))
    turns = exp_so3(np.cumsum(0.1 * rng.normal(size=(60, 24, 3)), axis=0))
    pelvis, spine = SMPL_JOINTS.index("pelvis"), SMPL_JOINTS.index("spine1")
    turns[:, spine] = turns[:, pelvis] @ exp_so3(0.01 * rng.normal(size=(60, 3)))
    joints[:, spine] = joints[:, pelvis] + turns[:, pelvis] @ [0.0, 0.1, 0.0]
    plate = np.array([[0.0, 0.05, -0.1], [0.06, 0.08, -0.1], [-0.06, 0.08, -0.1], [0.0, 0.0, -0.12]])
    carrier = turns[:, pelvis] @ exp_so3(0.05 * rng.normal(size=(60, 3)))  # skin
    points = joints[:, pelvis, None] + plate @ carrier.swapaxes(-1, -2) + 0.001 * rng.normal(size=(60, 4, 3))
    labels, bones = ("P1", "P2", "P3", "SACR"), BonePoses(joints, turns)
    assert common_bones(points, labels, bones, {"SACR": (pelvis,)}) == dict.fromkeys(labels[:3], "pelvis")
    found = common_bones(points, labels, bones, {})
    assert len(found) == 4 and len(set(found.values())) == 1
    apart = points + 0.05 * rng.normal(size=points.shape)
    assert not common_bones(apart, labels, bones, {"SACR": (pelvis,)})
