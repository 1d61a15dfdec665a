"""Skin on the floor: found only where it touches, kept above the floor and in place by a solve."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest import mock

import numpy as np
import pytest

from research.simulation.benchmark import BenchmarkSettings, film_benchmark
from solver_backend.biomechanics.support import FLOOR_M
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.exchange.contact_parts import CONTACT_PARTS
from solver_backend.exchange.diagnostics import diagnostic
from solver_backend.exchange.errors import JobInvalid
from solver_backend.exchange.joint_sets import SMPL_JOINTS, JointSet
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.keyframes.frame_range import FrameRange, UserContact
from solver_backend.fitters.model.subject import FrameObjective, PosedFrames, Subject, frame_equations, points_of
from solver_backend.fitters.pipeline import resolve_range, solve
from solver_backend.fitters.recipes.frame_range import trusted_world, with_earlier_contacts
from solver_backend.fitters.skin_contacts import (
    FLOOR,
    HANDS,
    SkinContacts,
    contradicts,
    find_skin_contacts,
    parts_of_skin,
)
from solver_backend.geometry.obstacles import Obstacles
from solver_backend.geometry.rotations import exp_so3, log_so3
from solver_backend.residuals.positions import PositionTerm, SurfaceTerm
from solver_backend.synthesis.simulation.cast import UPRIGHT, Person
from solver_backend.types import Motion
from tests.support.floor_takes import FPS, kneeling

FRAMES = 60


def standing(frames: int = FRAMES) -> Person:
    """Return a person who stands."""
    person = kneeling(frames, 0.0)
    return replace(person, local=np.tile(np.eye(3), (frames, 21, 1, 1)), transl=person.transl + [0.0, 0.0, 0.45])


def found(person: Person, sunk_m: float = 0.0) -> tuple[SkinContacts | None, Subject, PosedFrames]:
    """Return the contacts of a person who is too low by so much."""
    subject = Subject.average(person.body, keypoint_landmarks(person.body, JointSet.BODY_25), np.zeros(1))
    frames = PosedFrames(person.orient, person.local, person.transl - [0.0, 0.0, sunk_m])
    return find_skin_contacts(subject, frames, np.asarray(points_of(subject, frames)), FPS), subject, frames


def test_knees_touch_and_nothing_else_does() -> None:
    contacts, _, _ = found(kneeling(), 0.015)
    assert contacts is not None
    touching = dict(zip(CONTACT_PARTS, contacts.touches.mean(axis=0), strict=True))
    assert touching["left_knee"] == touching["right_knee"] == 1.0
    assert not any(touching[part] for part in ("back", "head", "left_hand", "left_elbow"))


@pytest.mark.parametrize("sunk_m", [0.0, 0.02])
def test_feet_alone_change_nothing(sunk_m: float) -> None:
    assert found(standing(), sunk_m)[0] is None


@pytest.mark.parametrize("sunk_m", [0.05, 0.12])
def test_a_wrong_floor_is_named_and_not_obeyed(sunk_m: float) -> None:
    contacts, _, _ = found(kneeling(), sunk_m)
    assert contacts is not None and not contacts.binds and not contacts.touches.any()
    [note] = contacts.notes()
    assert note.code == "feet_off_floor"
    assert note.values == {"size": pytest.approx(100 * sunk_m, abs=0.5), "way": "below"}


def test_a_floor_below_the_person_changes_nothing() -> None:
    assert found(kneeling(), -0.05)[0] is None


def test_a_hand_that_hangs_into_the_floor_does_not_hide_it() -> None:
    person = kneeling(FRAMES, 0.0)
    local = np.tile(np.eye(3), (FRAMES, 21, 1, 1))
    for name, turn in (
        ("left_wrist", [0, -1.5, 0]),
        ("left_shoulder", [0, -0.15, 0]),
        ("left_ankle", [1.4, 0, 0]),
        ("right_ankle", [1.4, 0, 0]),
    ):
        local[:, SMPL_JOINTS.index(name) - 1] = exp_so3(np.array(turn, float))
    prone = UPRIGHT @ exp_so3(np.array([np.pi / 2, 0.0, 0.0]))
    person = replace(person, orient=np.tile(prone, (FRAMES, 1, 1)), local=local)
    skin, hands = person.skin(np.arange(1))[0, :, 2], np.isin(parts_of_skin(person.body), HANDS)
    person = replace(person, transl=person.transl - [0.0, 0.0, skin[~hands].min()])
    assert skin[hands].min() - skin[~hands].min() < -0.05
    contacts, _, _ = found(person)
    assert contacts is not None and contacts.solid.all() and contacts.touches.any()


def handstand(height_m: float = 0.0) -> Person:
    """Return a person who stands on straight arms, with the hands' lowest skin this far above the floor."""
    person = kneeling(FRAMES, 0.0)
    local = np.tile(np.eye(3), (FRAMES, 21, 1, 1))
    for side, sign in (("left", 1.0), ("right", -1.0)):
        local[:, SMPL_JOINTS.index(f"{side}_shoulder") - 1] = exp_so3(np.array([0.0, 0.0, 1.4 * sign]))
        local[:, SMPL_JOINTS.index(f"{side}_wrist") - 1] = exp_so3(np.array([-1.3, 0.0, 0.0]))
    upside_down = UPRIGHT @ exp_so3(np.array([np.pi, 0.0, 0.0]))
    person = replace(person, orient=np.tile(upside_down, (FRAMES, 1, 1)), local=local)
    skin, hands = person.skin(np.arange(1))[0, :, 2], np.isin(parts_of_skin(person.body), HANDS)
    assert skin[~hands].min() - skin[hands].min() > FLOOR_M
    return replace(person, transl=person.transl + [0.0, 0.0, height_m - skin[hands].min()])


def test_a_handstand_is_on_the_floor() -> None:
    contacts, _, _ = found(handstand())
    assert contacts is not None and contacts.solid.all() and contacts.touches[:, HANDS].all()
    assert {item.code for item in contacts.notes()} == {"skin_held"}


def test_a_handstand_above_the_floor_touches_nothing() -> None:
    contacts, _, _ = found(handstand(0.12))
    assert contacts is None or not contacts.touches.any()


def test_a_single_frame_has_no_contacts_and_no_warnings() -> None:
    contacts, _, _ = found(kneeling(1), 0.015)
    assert contacts is not None and contacts.solid.all() and not contacts.held.any()


def test_held_points_stay_above_the_floor_and_the_lowest_is_on_it() -> None:
    contacts, _, _ = found(kneeling(), 0.015)
    assert contacts is not None
    heights = contacts.anchors[contacts.held][:, 2]
    assert heights.min() > -1e-9 and heights.min() < 1e-3 and heights.max() < 0.05


def test_the_equations_follow_the_skin() -> None:
    contacts, subject, frames = found(kneeling(8), 0.015)
    assert contacts is not None
    points = np.asarray(points_of(subject, frames))
    data = PositionTerm.of(points + 0.01, np.broadcast_to(1e-4 * np.eye(3), (*points.shape, 3)), points)
    objective = FrameObjective((data,), skin=contacts.terms(points, 1.0)).select(slice(2, 6))
    frames = frames.select(slice(2, 6))
    equations = frame_equations(subject, frames, objective, 3.0)
    assert equations.hessian.shape == (4, 69, 69)
    direction = np.random.default_rng(0).normal(size=equations.gradient.shape)
    costs = [frame_equations(subject, frames.retract(sign * 1e-6 * direction), objective, 3.0).cost for sign in (1, -1)]
    np.testing.assert_allclose((costs[0] - costs[1]) / 2e-6, (equations.gradient * direction).sum(axis=1), rtol=1e-4)
    bare = frame_equations(subject, frames, replace(objective, skin=None), 3.0)
    assert (equations.cost > bare.cost).all()


def test_a_surface_pulls_only_what_is_behind_it() -> None:
    normals = np.tile([0.6, 0.0, 0.8], (1, 2, 1))
    term = SurfaceTerm(normals, np.full((1, 2), 0.5), np.full((1, 2), 1e4))
    evidence = term(np.array([[[0.6, 5.0, 0.8], [0.0, 0.0, 0.6]]]), 3.0)
    np.testing.assert_allclose(evidence.cost, 0.5 * 1e4 * 0.02**2, rtol=0.01)
    np.testing.assert_allclose(evidence.gradient[0], [[0.0, 0.0, 0.0], -0.02 * 1e4 * normals[0, 1]], rtol=0.02)


def test_a_surface_far_above_a_point_pulls_less_than_a_near_one() -> None:
    normals = np.tile([0.0, 0.0, 1.0], (1, 2, 1))
    evidence = SurfaceTerm(normals, np.zeros((1, 2)), np.full((1, 2), 2.5e5))(
        np.array([[[0, 0, -0.01], [0, 0, -0.4]]]), 3.0
    )
    assert abs(evidence.gradient[0, 1, 2]) < 0.02 * abs(evidence.gradient[0, 0, 2])


@pytest.mark.slow
def test_a_solve_keeps_knees_on_the_floor() -> None:
    person = kneeling(90)
    capture = film_benchmark(person, FPS, "kneeling", BenchmarkSettings(seed=3), np.random.default_rng(3))
    depths, errors = [], []
    for contacts in (True, False):
        motion = solve(capture, SolveSettings(contacts=contacts)).motion
        turns = motion.body_pose.reshape(motion.num_frames, -1, 3)[:, :21].astype(np.float64)
        root, transl = exp_so3(motion.global_orient.astype(np.float64)), motion.transl.astype(np.float64)
        solved = Person(person.body, motion.betas.astype(np.float64), root, exp_so3(turns), transl)
        depths.append(-solved.skin(np.arange(90))[..., 2].min(axis=1))
        errors.append(np.linalg.norm(motion.joints - capture.truth["joints"], axis=-1).mean())
    assert np.percentile(depths[0], 95) < 0.005
    assert np.percentile(depths[1], 95) > 0.015
    assert errors[0] < errors[1] + 0.004


def told(part: str, *, touches: bool, first: int = 10, last: int = 40) -> SkinContacts:
    """Return the contacts of a person who kneels 15 mm too low with one that somebody changed."""
    person = kneeling()
    subject = Subject.average(person.body, keypoint_landmarks(person.body, JointSet.BODY_25), np.zeros(1))
    frames = PosedFrames(person.orient, person.local, person.transl - [0.0, 0.0, 0.015])
    change = (UserContact(part, first, last, touches),)
    contacts = find_skin_contacts(subject, frames, np.asarray(points_of(subject, frames)), FPS, told=change)
    assert contacts is not None
    return contacts


def test_a_removed_contact_is_released_in_its_frames_alone() -> None:
    touching = told("left_knee", touches=False).touches[:, list(CONTACT_PARTS).index("left_knee")]
    assert not touching[10:41].any() and touching[:10].all() and touching[41:].all()


def test_an_added_contact_pulls_the_lowest_skin_to_the_floor() -> None:
    contacts = told("left_hand", touches=True)
    hand = contacts.parts == list(CONTACT_PARTS).index("left_hand")
    assert contacts.held[10:41, hand].any(axis=1).all() and not contacts.held[:10, hand].any()
    held = contacts.held[25, hand]
    assert abs(contacts.anchors[25, hand][held, 2].min()) < 0.01


def test_contacts_outside_the_range_or_of_no_part_are_refused() -> None:
    values = {"part": "left_knee", "first": 3, "last": 9, "touches": True}
    FrameRange.from_dict({"first": 2, "last": 9, "contacts": [values]}).check(20)
    with pytest.raises(JobInvalid, match="outside the range"):
        FrameRange.from_dict({"first": 4, "last": 9, "contacts": [values]}).check(20)
    for change in ({"part": "tail"}, {"touches": 1}, {"first": "a"}):
        with pytest.raises(JobInvalid):
            FrameRange.from_dict({"first": 2, "last": 9, "contacts": [values | change]})


def test_knees_rest_on_a_declared_platform() -> None:
    person = kneeling()
    subject = Subject.average(person.body, keypoint_landmarks(person.body, JointSet.BODY_25), np.zeros(1))
    raised = PosedFrames(person.orient, person.local, person.transl + [0.0, 0.0, 0.488])
    points = np.asarray(points_of(subject, raised))
    assert find_skin_contacts(subject, raised, points, FPS) is None
    a, b, c, d = (np.array([x, y, 0.5]) for x, y in ((-2, -2), (2, -2), (2, 2), (-2, 2)))
    box = Obstacles(FLOOR.planes, (np.array([[a, b, c], [a, c, d]]),))
    contacts = find_skin_contacts(subject, raised, points, FPS, box)
    assert contacts is not None and contacts.touches[:, 2:4].all()
    held = contacts.held & (contacts.parts == 2)
    np.testing.assert_allclose(contacts.anchors[held][:, 2].min(), 0.5, atol=2e-3)
    np.testing.assert_allclose(contacts.offsets[held], 0.5, atol=1e-9)


def touching_at(person: Person, heights: np.ndarray, world: Obstacles = FLOOR, **told: Any) -> SkinContacts | None:
    """Return the contacts of a person whose frames are raised by these heights."""
    subject = Subject.average(person.body, keypoint_landmarks(person.body, JointSet.BODY_25), np.zeros(1))
    transl = person.transl + heights[:, None] * [0.0, 0.0, 1.0]
    frames = PosedFrames(person.orient, person.local, transl)
    return find_skin_contacts(subject, frames, np.asarray(points_of(subject, frames)), FPS, world, **told)


def grounded(frames: int) -> Person:
    """Return a person who stands with the lowest skin at z = 0."""
    person = standing(frames)
    return replace(person, transl=person.transl - [0.0, 0.0, person.skin(np.arange(1))[..., 2].min()])


def kneels_late(still: int, knelt: int) -> Person:
    """Return a person who stands and then kneels."""
    one, other = grounded(still), kneeling(knelt)
    parts = ((getattr(one, name), getattr(other, name)) for name in ("orient", "local", "transl"))
    orient, local, transl = (np.concatenate(pair) for pair in parts)
    return replace(one, orient=orient, local=local, transl=transl)


FAR_BOX = Obstacles(FLOOR.planes, (np.array([[[3.0, 3, 0.5], [4, 3, 0.5], [4, 4, 0.5]]]),))


@pytest.mark.parametrize("world", [FLOOR, FAR_BOX])
def test_a_lower_floor_in_the_last_third_is_no_contact(world: Obstacles) -> None:
    heights = -0.35 * np.clip((np.arange(70) - 40) / 8.0, 0.0, 1.0)
    assert touching_at(grounded(70), heights, world) is None


def test_objects_do_not_make_a_wrong_floor_solid() -> None:
    on_box = np.array(
        [[[-2.0, -2, -0.4], [2, -2, -0.4], [2, 2, -0.4]], [[-2.0, -2, -0.4], [2, 2, -0.4], [-2, 2, -0.4]]]
    )
    contacts = touching_at(grounded(60), np.full(60, -0.4), Obstacles(FLOOR.planes, (on_box,)))
    assert contacts is not None and np.abs(contacts.anchors[contacts.held][:, 2] + 0.4).max() < 0.03
    [note] = [item for item in contacts.notes() if item.code == "feet_off_floor"]
    assert note.values == {"size": pytest.approx(40.0, abs=1.0), "way": "below"}


def test_a_touch_holds_only_its_own_frames() -> None:
    contacts = touching_at(kneels_late(200, 10), np.full(210, -0.02))
    assert contacts is not None and contacts.held[200:, contacts.parts == 2].any()
    far = slice(0, 200 - round(0.1 * FPS))
    assert not contacts.held[far].any() and not contacts.touches[far].any() and contacts.solid.all()
    [note] = contacts.notes()
    assert note.code == "skin_held" and "left knee" in note.values["parts"]


def test_an_added_contact_without_a_floor_is_reported() -> None:
    told = (UserContact("left_hand", 10, 40, True),)
    contacts = touching_at(kneeling(), np.full(FRAMES, 0.12), told=told)
    assert contacts is not None and contacts.afloat[10:41].all() and contacts.held[10:41].any()
    assert not contacts.solid.any()
    assert {item.code for item in contacts.notes()} == {"skin_held", "feet_off_floor"}
    on_floor = touching_at(kneeling(), np.zeros(FRAMES), told=told)
    assert on_floor is not None and not on_floor.afloat.any()


def test_without_detection_only_told_contacts_are_held() -> None:
    told = (UserContact("head", 20, 22, False), UserContact("left_hand", 10, 40, True))
    contacts = touching_at(kneeling(), np.full(FRAMES, -0.015), told=told, detects=False)
    assert contacts is not None and not contacts.solid.any()
    assert set(np.flatnonzero(contacts.touches.any(axis=0))) == {list(CONTACT_PARTS).index("left_hand")}


@pytest.mark.slow
@pytest.mark.parametrize("step_m", [0.05, 0.17])
def test_a_person_who_kneels_and_steps_down_is_not_torn(step_m: float) -> None:
    rises, ramp = np.r_[np.ones(30), np.linspace(1.0, 0.0, 30), np.zeros(50)], np.linspace(0.0, 1.0, 8)
    floor = -step_m * np.r_[np.zeros(70), ramp, np.ones(32)]
    one = kneeling(1, 0.0)
    local = exp_so3(rises[:, None, None] * log_so3(one.local[0]))
    person = replace(one, orient=np.tile(one.orient, (110, 1, 1)), local=local, transl=np.zeros((110, 3)))
    lowest = person.skin(np.arange(110))[..., 2].min(axis=1)
    person = replace(person, transl=(floor - lowest)[:, None] * [0.0, 0.0, 1.0])
    capture = film_benchmark(person, FPS, "step", BenchmarkSettings(seed=5), np.random.default_rng(5))
    with mock.patch("solver_backend.fitters.recipes.bundle.find_skin_contacts", return_value=None):
        bare = solve(capture).motion
    found = solve(capture).motion
    assert found.touches is not None and found.touches[:, 2:4].any()
    errors = [np.linalg.norm(m.joints - capture.truth["joints"], axis=-1).mean(axis=1) for m in (found, bare)]
    assert errors[0].mean() < errors[1].mean() + 0.001 and errors[0].max() < errors[1].max() + 0.003


@pytest.mark.slow
def test_a_step_down_is_solved_as_without_contacts_of_the_skin() -> None:
    person = grounded(70)
    way = -0.35 * np.clip((np.arange(70) - 40) / 8.0, 0.0, 1.0)
    person = replace(person, transl=person.transl + way[:, None] * [0.0, 0.0, 1.0])
    capture = film_benchmark(person, FPS, "step", BenchmarkSettings(seed=3), np.random.default_rng(3))
    found = solve(capture).motion
    with mock.patch("solver_backend.fitters.recipes.bundle.find_skin_contacts", return_value=None):
        bare = solve(capture).motion
    np.testing.assert_array_equal(found.joints, bare.joints)


@pytest.mark.parametrize(("parts", "quantile"), [(1, 10.83), (2, 13.82), (5, 20.52), (11, 31.26)])
def test_a_surface_is_contradicted_beyond_the_quantile_of_chi_squared(parts: int, quantile: float) -> None:
    works = np.tile(np.arange(11) < parts, (30, 1))
    swing = 20.0 * np.sin(np.arange(30.0) * 2.0 * np.pi / 30)
    assert not contradicts(works, 0.95 * quantile + swing) and contradicts(works, 1.05 * quantile + swing)


def test_a_wrong_seat_counts_in_its_own_frames() -> None:
    works = np.zeros((300, 11), bool)
    works[:, :2], works[200:230, 8] = True, True
    rise = np.where(works[:, 8], 40.0, 0.0)
    assert contradicts(works, rise) and not contradicts(works[:, :8], rise)
    assert not contradicts(np.zeros((300, 11), bool), rise)


def codes_of(motion: Motion) -> dict[str, dict[str, Any]]:
    """Return the values of a motion's diagnostics by code."""
    return {item["code"]: item["values"] for item in motion.provenance.get("diagnostics", ())}


@pytest.mark.slow
def test_an_object_is_obeyed_unless_the_views_contradict_it(tmp_path: Path) -> None:
    person = kneeling(60)
    person = replace(person, transl=person.transl + [0.0, 0.0, 0.3])
    capture = film_benchmark(person, FPS, "platform", BenchmarkSettings(seed=6), np.random.default_rng(6))
    bare, file = solve(capture).motion, tmp_path / "objects.json"
    assert bare.touches is None
    for off_m in (0.0, 0.06):
        file.write_text(json.dumps({"planes": [{"point": [0, 0, 0.3 + off_m], "normal": [0, 0, 1]}]}))
        settings = SolveSettings(objects=str(file))
        motion = solve(capture, settings).motion
        if off_m:
            np.testing.assert_array_equal(motion.joints, bare.joints)
            assert codes_of(motion)["surface_contradicted"] == {"surface": "objects"} and motion.touches is None
            assert not trusted_world(settings, motion).has_objects
        else:
            assert "surface_contradicted" not in codes_of(motion)
            assert (
                motion.touches is not None
                and motion.touches[:, 2:4].any()
                and trusted_world(settings, motion).has_objects
            )


def test_one_camera_does_not_use_objects_and_says_so(tmp_path: Path) -> None:
    person, file = kneeling(24), tmp_path / "objects.json"
    views = film_benchmark(person, FPS, "kneels", BenchmarkSettings(seed=6), np.random.default_rng(6)).views([0])
    file.write_text(json.dumps({"planes": [{"point": [0, 0, 0.05], "normal": [0, 0, 1]}]}))
    settings = SolveSettings(objects=str(file), iterations=1)
    motion = solve(views, settings).motion
    assert codes_of(motion)["setting_without_effect"]["settings"] == "objects"
    again = resolve_range(views, motion, FrameRange(6, 18), settings).motion
    assert again.touches is None, "the whole take has no check whether the floor is true"


@pytest.mark.slow
def test_a_floor_far_above_a_standing_person_is_only_named() -> None:
    person = grounded(30)
    person = replace(person, transl=person.transl - [0.0, 0.0, 0.4])
    capture = film_benchmark(person, FPS, "below", BenchmarkSettings(seed=3), np.random.default_rng(3))
    motion = solve(capture).motion
    assert codes_of(motion)["feet_off_floor"]["way"] == "below" and motion.touches is None


def test_a_refused_floor_stays_refused() -> None:
    motion: Any = SimpleNamespace(
        provenance={"diagnostics": [diagnostic("surface_contradicted", surface="floor").as_dict()]}
    )
    assert np.isinf(trusted_world(SolveSettings(), motion).nearest(np.zeros((1, 3)), 0.25)[0]).all()


def test_contacts_of_earlier_solves_are_remembered_once() -> None:
    motion: Any = SimpleNamespace(provenance={"resolved": []}, num_frames=100)
    new = (UserContact("left_hand", 30, 45, True),)
    for first, last in ((20, 60), (35, 50), (20, 60), (20, 60)):
        full = with_earlier_contacts(FrameRange(first, last, contacts=new), motion)
        noted = {"first": first, "last": last, "contacts": [asdict(contact) for contact in full.contacts]}
        motion.provenance["resolved"].append(noted)
        new = ()
    full = with_earlier_contacts(FrameRange(0, 99), motion)
    assert sorted((c.first, c.last) for c in full.contacts) == [(30, 34), (35, 45)]
    assert not with_earlier_contacts(FrameRange(0, 99, forgets=True), motion).contacts


def test_a_range_that_forgets_survives_its_file() -> None:
    assert FrameRange.from_dict(FrameRange(2, 9, forgets=True).as_dict()).forgets
    with pytest.raises(JobInvalid, match="forgets"):
        FrameRange.from_dict({"first": 2, "last": 9, "forgets": 1})
