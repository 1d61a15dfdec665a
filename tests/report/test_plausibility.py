"""A result that no person can be is named; one that is surely useless is an error."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.cameras.projection import project
from solver_backend.exchange.diagnostics import Diagnostic, Severity
from solver_backend.geometry.rotations import exp_so3
from solver_backend.report.checks import _feet, diagnose
from solver_backend.types import Capture, Motion, PersonInViews
from tests.support.solved import solved


def found(capture: Capture, motion: Motion) -> dict[str, Diagnostic]:
    return {item.code: item for item in diagnose(capture, motion)}


@pytest.mark.parametrize(
    ("scale", "severity"),
    [(0.3, Severity.ERROR), (0.5, Severity.WARNING), (1.0, None), (1.5, Severity.WARNING), (3.3, Severity.ERROR)],
)
def test_a_body_of_no_persons_size_is_named(scale: float, severity: Severity | None) -> None:
    capture, motion = solved(faults=False)
    items = found(capture, replace(motion, joints=scale * motion.joints))
    assert {c for c in items if c.startswith("stature")} == ({"stature_odd"} if severity else set())
    if severity:
        assert items["stature_odd"].values["size"] == pytest.approx(scale * 1.796, rel=0.001)
        assert items["stature_odd"].severity is severity


def disagreeing(views: int, wrong: int) -> tuple[Capture, Motion]:
    """Return a solve of so many views, some of which see the person somewhere else."""
    capture, motion = solved(faults=False, views=views)
    error = motion.reprojection_px.copy()
    error[:wrong] = 300.0
    return capture, replace(motion, reprojection_px=error)


@pytest.mark.parametrize(
    ("views", "wrong", "severity"),
    [(4, 1, None), (3, 1, Severity.WARNING), (4, 2, Severity.ERROR), (6, 3, Severity.WARNING), (8, 2, None)],
)
def test_views_that_see_the_person_elsewhere_are_counted(views: int, wrong: int, severity: Severity | None) -> None:
    item = found(*disagreeing(views, wrong)).get("views_contradict")
    assert (item and item.severity) == severity
    if item:
        assert item.values["percent"] == pytest.approx(100 * (1 - wrong / views), abs=0.1)
        assert len(item.where.cameras) == wrong


@pytest.mark.parametrize(("share", "code"), [(0.3, ""), (0.7, "views_contradict")])
def test_of_two_views_one_that_mostly_sees_something_else_leaves_nothing(share: float, code: str) -> None:
    capture, motion = solved(faults=False, views=2)
    error = motion.reprojection_px.copy()
    error[0, : round(share * motion.num_frames)] = 300.0
    items = found(capture, replace(motion, reprojection_px=error))
    assert {c for c in items if c == "views_contradict"} == ({code} if code else set())


def test_a_view_that_was_left_out_contradicts_nobody() -> None:
    capture, motion = disagreeing(4, 2)
    names = capture.cameras.names
    motion = replace(
        motion, provenance={**motion.provenance, "settings": {"leave_out": [names[0], f"{names[1]}:0-89"]}}
    )
    assert "views_contradict" not in found(capture, motion)


def test_others_count_only_where_the_person_should_be_seen() -> None:
    """Two cameras see the person, two somebody else: in her place, in another corner, or where she is out of view."""
    capture, motion = solved(faults=False)
    confidence = capture.keypoints.confidence
    mine, theirs = confidence.copy(), np.zeros_like(confidence)
    mine[2:], theirs[2:] = 0.0, 1.0
    in_her_place = replace(capture.keypoints, xy=project(capture.cameras, motion.keypoints3d), confidence=theirs)
    other = PersonInViews("Person 2", in_her_place)
    main = replace(capture.keypoints, confidence=mine)
    people = (PersonInViews("Person 1", main), other)
    beside = replace(capture, keypoints=main, people=people, person="Person 1")
    assert "views_contradict" in found(beside, motion)
    corner = replace(other, keypoints=replace(in_her_place, xy=in_her_place.xy + 800.0))
    assert "views_contradict" not in found(replace(beside, people=(people[0], corner)), motion)
    away = replace(beside, cameras=replace(capture.cameras, t=capture.cameras.t + np.repeat([0.0, 30.0], 2)[:, None]))
    assert "views_contradict" not in found(away, motion)


def test_people_who_enter_leave_and_hide_each_other_contradict_nobody() -> None:
    """Three others are in her place in two or four views: before she enters, after she left, and as they pass her."""
    capture, motion = solved(faults=False)
    shape = capture.keypoints.confidence.shape
    in_her_place, aside = project(capture.cameras, motion.keypoints3d), np.full((*shape, 2), 60.0)
    frames = motion.num_frames
    hers = np.zeros(shape)
    hers[:, frames // 4 : 3 * frames // 4] = 1.0
    hers[2:, frames // 3 : 2 * frames // 3] = 0.0  # somebody passes her in two of four views
    spans = (slice(0, frames // 4), slice(3 * frames // 4, None), slice(frames // 3, 2 * frames // 3))
    people = [PersonInViews("Person 1", replace(capture.keypoints, confidence=hers))]
    for number, span in enumerate(spans, 2):
        xy, confidence = aside.copy(), np.zeros(shape)
        confidence[:, span], xy[2:, span] = 1.0, in_her_place[2:, span]
        people.append(PersonInViews(f"Person {number}", replace(capture.keypoints, xy=xy, confidence=confidence)))
    several = replace(capture, keypoints=people[0].keypoints, people=tuple(people), person="Person 1")
    assert "views_contradict" not in found(several, motion)


def test_a_body_far_from_its_detections_is_named() -> None:
    capture, motion = solved(faults=False)
    far = found(capture, replace(motion, reprojection_px=np.full_like(motion.reprojection_px, 30.0)))
    assert far["residual_large"].values["share"] > 4.0
    useless = found(capture, replace(motion, reprojection_px=np.full_like(motion.reprojection_px, 120.0)))
    assert useless["residual_large"].severity is Severity.ERROR


def test_a_person_who_stands_tilted_is_named() -> None:
    capture, motion = solved(faults=False)
    tilt = exp_so3(np.array([np.radians(35.0), 0.0, 0.0]))
    items = found(capture, replace(motion, joints=motion.joints @ tilt.T))
    assert items["person_tilted"].values["size"] == pytest.approx(35.0, abs=6.0)
    lying = exp_so3(np.array([np.pi / 2, 0.0, 0.0]))
    assert "person_tilted" not in found(capture, replace(motion, joints=motion.joints @ lying.T))


def test_feet_off_the_floor_and_sliding_feet_are_named() -> None:
    capture, motion = solved(faults=False)
    deep = motion.joints - [0.0, 0.0, 0.2]
    deep[0, :, 2] -= 0.5  # the size is that of most frames
    sunk = found(capture, replace(motion, joints=deep))
    assert sunk["feet_off_floor"].values["size"] == pytest.approx(17.0, abs=0.5)
    above = found(capture, replace(motion, joints=motion.joints + [0.0, 0.0, 0.5]))
    assert above["feet_off_floor"].values["size"] == pytest.approx(53.0, abs=0.5)
    assert above["feet_off_floor"].severity == Severity.NOTE
    high = found(capture, replace(motion, joints=motion.joints + [0.0, 0.0, 2.0]))
    assert high["feet_off_floor"].severity == Severity.WARNING
    joints = motion.joints.copy()
    joints[:, 10:12, 1] += 0.03 * np.arange(len(joints))[:, None]
    joints[:, 10:12, 2] = 0.0
    assert "feet_slide" in found(capture, replace(motion, joints=joints))


def test_a_person_who_jumps_from_a_box_needs_no_other_floor() -> None:
    capture, motion = solved(faults=False)
    joints, half = motion.joints.copy(), len(motion.joints) // 2
    joints[: half + half // 2, :, 2] += 0.9
    centres = replace(motion, provenance=motion.provenance | {"markers": ["=left_hip", "=right_hip"]})
    assert not {"feet_off_floor", "take_drifts"} & found(capture, replace(centres, joints=joints)).keys()


def test_stairs_and_trampolines_need_no_other_floor() -> None:
    capture, motion = solved(faults=False)
    centres = replace(motion, provenance=motion.provenance | {"markers": ["=left_hip", "=right_hip"]})
    standing = np.repeat(motion.joints[:1], motion.num_frames, axis=0)
    seconds = np.arange(motion.num_frames) / motion.fps
    climb = 0.17 * (np.floor(2.0 * seconds) + np.clip((2.0 * seconds) % 1.0 - 0.6, 0.0, 0.4) / 0.4)
    bounce = 1.0 + 1.5 * np.abs(np.sin(np.pi * seconds))
    for height in (climb, climb[::-1], bounce):
        joints = standing + height[:, None, None] * [0.0, 1.6, 1.0]
        codes = {item.code for item in _feet(capture, replace(centres, joints=joints))}
        assert not {"feet_off_floor", "take_drifts"} & codes
    joints = standing + np.linspace(2.0, 0.0, motion.num_frames)[:, None, None] * [0.0, 0.0, 1.0]
    assert "take_drifts" in {item.code for item in _feet(capture, replace(centres, joints=joints))}


@pytest.mark.parametrize(("views", "centres", "drifts"), [(1, False, True), (4, True, True), (4, False, False)])
def test_a_body_that_sinks_steadily_is_named_unless_several_cameras_saw_it(
    views: int, centres: bool, drifts: bool
) -> None:
    capture, motion = solved(faults=False, views=views)
    if centres:
        motion = replace(motion, provenance=motion.provenance | {"markers": ["=left_hip", "=right_hip"]})
    joints = motion.joints.copy()
    joints[..., 2] += np.linspace(2.0, 0.0, len(joints))[:, None]
    assert ("take_drifts" in found(capture, replace(motion, joints=joints))) == drifts


def test_noise_of_a_fast_recording_is_no_sliding() -> None:
    capture, motion = solved(faults=False)
    joints = np.repeat(motion.joints[:1], len(motion.joints), axis=0)
    joints[:, 10:12, 2] = 0.0
    joints[:, 10:12, :2] += 0.0008 * np.random.default_rng(0).normal(size=(len(joints), 2, 2))
    assert "feet_slide" not in found(capture, replace(motion, joints=joints, fps=240.0))
