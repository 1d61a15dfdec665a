"""Marker files that people really have, each as small as it can be: solved, or refused with the true reason."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from solver_backend.exchange.diagnostics import sentence
from solver_backend.fitters import SolveSettings, solve
from solver_backend.io.load import load_capture
from solver_backend.report.checks import recorded_diagnostics
from solver_backend.types import FLAG_RESTING, SMPL_JOINTS, Capture, Motion
from tests.support.recordings import ABSENT, recordings_folder

CASES = recordings_folder() / "cases" / "markers"
WRISTS, ARMS = ("left_wrist", "right_wrist"), ("left_elbow", "right_elbow", "left_wrist", "right_wrist")
LEGS = ("left_knee", "right_knee", "left_ankle", "right_ankle")
SOLVED: dict[str, tuple[dict[str, Any], tuple[str, ...], float]] = {
    "lower_body_arms_invented/sample14.c3d": ({}, ARMS, 5.0),
    "joint_centres_as_markers/shadow_joints.c3d": ({}, (), 20.0),
    "motive_unlabeled_is_a_subject/motive_unlabeled_colon.csv": ({}, (), 10.0),
    "cgm2_computed_points/cgm24.c3d": ({}, ARMS, 8.0),
    "xsens_c3d_labels/mvn.c3d": ({}, (), 12.0),
    "bts_labels/bts.c3d": ({}, ARMS, 8.0),
    "excel_and_locale_text/commas.trc": ({}, (), 10.0),
    "excel_and_locale_text/decimal_commas.trc": ({}, (), 10.0),
    "excel_and_locale_text/motive_semicolons.csv": ({}, (), 10.0),
    "one_person_many_prefixes/rigid_bodies.c3d": (
        {"subject_prefix": "ArmL,ForearmL,BodyL"}, (*LEGS, "left_wrist", "right_elbow", "right_wrist"), 5.0,
    ),
}  # fmt: skip
"""By file: options, joints that rest in every frame, and the largest median residual in millimetres."""
pytestmark = [pytest.mark.slow, pytest.mark.skipif(not CASES.is_dir(), reason=ABSENT)]


def places(motion: Motion, joint: str) -> np.ndarray:
    return motion.joints[:, SMPL_JOINTS.index(joint)]


@pytest.mark.parametrize("name", SOLVED)
def test_a_file_is_solved(name: str) -> None:
    options, resting, residual_mm = SOLVED[name]
    motion = solve(load_capture(CASES / name, **options), SolveSettings(contacts=False)).motion
    assert motion.marker_residual_mm is not None and np.nanmedian(motion.marker_residual_mm) < residual_mm
    rests = np.zeros(len(SMPL_JOINTS), dtype=bool) if motion.resting is None else motion.resting.all(axis=0)
    assert {joint for joint in (*ARMS, *LEGS) if rests[SMPL_JOINTS.index(joint)]} == set(resting)
    if resting:
        assert motion.flags is not None and (motion.flags & FLAG_RESTING).all()
    for joint in set(resting) & set(WRISTS):
        shoulder = places(motion, joint.replace("wrist", "shoulder"))
        assert (places(motion, joint)[:, 2] < shoulder[:, 2]).all()
    if "xsens" not in name:  # whose sample is of an unusual shape, which is reported
        assert np.abs(motion.betas).max() < 4.0


def test_joints_of_a_suit_are_where_it_records_them() -> None:
    """Its hips, neck, toes and fingers are at other places than this body's joints of these names."""
    capture = load_capture(CASES / "joint_centres_as_markers" / "shadow_joints.c3d")
    motion = solve(capture, SolveSettings(contacts=False)).motion
    assert capture.markers is not None and np.abs(motion.betas).max() < 3.0
    labels, names = (
        capture.markers.labels or (),
        dict(zip(motion.marker_labels or (), motion.layout or (), strict=True)),
    )
    limbs = {
        label: place[1:] for label, place in names.items()
        if place.endswith(("hip", "knee", "ankle", "shoulder", "elbow", "wrist", "=head"))
    }  # fmt: skip
    assert len(limbs) == 13
    for label, joint in limbs.items():
        off = np.linalg.norm(capture.markers.positions[:, labels.index(label)] - places(motion, joint), axis=-1)
        assert np.median(off) < 0.015


def test_rigid_bodies_named_by_bones_go_with_the_body() -> None:
    capture = load_capture(CASES / "one_person_many_prefixes" / "rigid_bodies.c3d")
    assert capture.markers is not None
    assert {label.partition(":")[0] for label in capture.markers.labels or ()} == {"BodyL", "ArmL", "ForearmL"}


def test_an_arm_without_its_side_is_that_of_the_side_it_is_on() -> None:
    capture = load_capture(CASES / "side_letter_glued_last" / "upper_body.c3d")
    motion = solve(capture, SolveSettings(contacts=False)).motion
    assert motion.resting is not None and capture.markers is not None
    rests = motion.resting.all(axis=0)
    assert rests[SMPL_JOINTS.index("left_wrist")] and not rests[SMPL_JOINTS.index("right_wrist")]
    labels = capture.markers.labels or ()
    elbow = capture.markers.positions[:, [labels.index(f"Person:EPIC{end}") for end in "lm"]].mean(axis=1)
    assert np.median(np.linalg.norm(places(motion, "right_elbow") - elbow, axis=-1)) < 0.03
    found = [item for item in recorded_diagnostics(motion) if item.code == "limb_side_found"]
    assert len(found) == 1 and "right" in sentence(found[0])


def test_rotations_of_segments_are_solved_as_a_skeleton() -> None:
    capture = load_capture(CASES / "c3d_rotations" / "C3DRotationExample.c3d")
    motion = solve(capture, SolveSettings(contacts=False)).motion
    assert motion.marker_residual_mm is not None and np.nanmedian(motion.marker_residual_mm) < 30.0


def test_knees_stay_where_the_plates_of_thigh_and_shank_carry_them() -> None:
    """The pelvis, thighs and shanks have only plates. Before their names were read, distances varied by 198 mm."""
    cloud = load_capture(CASES.parents[1] / "markers/automarkerlabel/transfer_learning_data/KneeltoProne01.c3d").markers
    assert cloud is not None
    cloud = replace(cloud, positions=cloud.positions[::24], residual=None, fps=cloud.fps / 24)
    motion = solve(Capture("take", markers=cloud), SolveSettings(contacts=False)).motion
    for side in ("left", "right"):
        plates = [f"{side[0].upper()}{plate}" for plate in ("THDP", "THDA", "SHPA", "SHPP")]
        points = cloud.positions[:, [cloud.names.index(label) for label in plates]]
        away = np.linalg.norm(points - places(motion, f"{side}_knee")[:, None], axis=-1)
        assert (np.nanquantile(away, 0.9, axis=0) - np.nanquantile(away, 0.1, axis=0) < 0.015).all()
