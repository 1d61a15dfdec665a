"""The shape of a person whom one calibrated camera sees: from the floor, a given stature, or an adult's."""

from dataclasses import replace

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.body.keypoints import keypoint_landmarks
from solver_backend.body.landmarks import Landmarks
from solver_backend.exchange.progress import silent
from solver_backend.exchange.solve_settings import SolveSettings
from solver_backend.fitters.model.subject import PosedFrames
from solver_backend.fitters.one_view.shape import (
    ALIKE_S,
    SeenShape,
    fit_shape,
    foot_columns,
    rising_shins,
    sole_heights,
    standing_soles,
    with_soles,
)
from solver_backend.fitters.pipeline import prepare, solve
from solver_backend.fitters.problem import SolvedFrames
from solver_backend.geometry.rotations import exp_so3
from solver_backend.priors.lifted_take import LiftedTake
from solver_backend.priors.view_lifter import LiftedView
from solver_backend.synthesis.simulation.cast import cast_person
from solver_backend.types import JointSet
from tests.support.floor_takes import FPS, kneeling
from tests.support.one_view_people import PersonTake, betas_of_stature, figures, filmed
from tests.support.walking_take import walk

UP = np.array([0.0, 0.0, 1.0])


def person_who_stands(stature: float, joint_set: JointSet, height: float) -> PersonTake:
    """Return somebody who bends the knees and moves the arms, with both feet on the floor."""
    body, rng, take = load_body(), np.random.default_rng(1), walk(90)
    bend = np.zeros((90, 22, 3))
    bend[:, [1, 2], 0] = -0.35 * np.sin(np.linspace(0.0, np.pi, 90))[:, None] ** 2
    bend[:, [4, 5], 0], bend[:, [7, 8], 0] = -2.0 * bend[:, [1, 2], 0], bend[:, [1, 2], 0]
    rotations = take.rotations.copy()
    rotations[:, 1:3] = np.eye(3)
    rotations = rotations @ exp_so3(bend)
    still = replace(take, rotations=rotations, root=np.tile(take.root.mean(axis=0), (90, 1)))
    person = cast_person(still, rng, body, betas=betas_of_stature(body, rng, stature))
    return filmed("stands", person.touching_the_floor(take.fps), take.fps, height, joint_set, rng)


def test_the_size_follows_the_solved_poses_unless_the_shape_is_given() -> None:
    body, rng, take = load_body(), np.random.default_rng(1), walk(60)
    bend = np.zeros((60, 22, 3))
    bend[:, 1:3, 0] = bend[:, 7:9, 0] = -0.9
    bend[:, 4:6, 0] = 1.8
    rotations = take.rotations.copy()
    rotations[:, 1:3] = np.eye(3)
    squats = replace(take, rotations=rotations @ exp_so3(bend), root=np.tile(take.root.mean(axis=0), (60, 1)))
    person = cast_person(squats, rng, body, betas=betas_of_stature(body, rng, 1.9)).touching_the_floor(FPS)
    capture = filmed("squats", person, FPS, 1.4, JointSet.BODY_25, rng).capture
    settings = SolveSettings()
    problem = prepare(capture, settings, silent)
    known = problem.measurements.known_person
    assert known is not None and body.stature_of(known.betas) < 1.75  # The lifted legs are bent too little.
    true = SolvedFrames(known, PosedFrames(person.orient, person.local, person.transl))
    again = problem.measurements.source.blocks(problem, true, settings)
    assert again.measurements.known_person is not None
    assert abs(body.stature_of(again.measurements.known_person.betas) / 1.9 - 1.0) < 0.02
    given = replace(settings, betas=tuple(person.betas))
    assert problem.measurements.source.blocks(problem, true, given) is problem


def test_the_record_states_the_size_of_the_second_solve() -> None:
    capture = person_who_stands(1.9, JointSet.BODY_25, 1.4).capture
    keypoints = capture.keypoints
    assert keypoints is not None
    few = replace(keypoints, xy=keypoints.xy[:, :45], confidence=keypoints.confidence[:, :45])
    motion, body = solve(replace(capture, keypoints=few)).motion, load_body()
    assert motion.provenance["size_factor"] == pytest.approx(body.stature_of(motion.betas) / body.stature_m, abs=1e-4)


@pytest.mark.parametrize(
    ("stature", "joint_set", "height"),
    [
        pytest.param(1.48, JointSet.COCO_17, 1.4, marks=pytest.mark.slow),
        (2.05, JointSet.BODY_25, 1.4),
        pytest.param(1.95, JointSet.COCO_17, 0.7, marks=pytest.mark.slow),
    ],
)
def test_small_and_tall_people_stand_on_the_floor(stature: float, joint_set: JointSet, height: float) -> None:
    found = figures(person_who_stands(stature, joint_set, height))
    assert found["stature"] < 5.5 and found["world"] < 80.0  # within two seconds
    assert found["soles_within_10mm"] > 85.0


def test_a_given_stature_is_kept_and_a_wrong_one_is_contradicted() -> None:
    take = person_who_stands(1.7, JointSet.BODY_25, 1.5)
    body = load_body()
    for stature, contradicted in ((1.72, False), (2.1, True)):
        motion = solve(replace(take.capture, stature_m=stature)).motion
        assert body.stature_of(motion.betas) == pytest.approx(stature, abs=1e-3)
        codes = {item["code"] for item in motion.provenance["diagnostics"]}
        assert ("stature_at_odds" in codes) is contradicted


@pytest.mark.parametrize(
    ("shape", "people"),
    [
        (SeenShape(np.zeros(10), 1.2, 0.02, 0.01), True),
        (SeenShape(np.zeros(10), 2.5, 0.02, 0.01), False),
        (SeenShape(np.zeros(10), 1.7, 0.02, -0.2), False),
        (SeenShape(np.zeros(10), 1.7, 0.02, np.nan), False),
    ],
)
def test_a_floor_that_nobody_could_stand_on_is_none(shape: SeenShape, people: bool) -> None:
    assert shape.fits_people is people


def test_points_under_the_feet_are_at_the_height_of_the_sole() -> None:
    body = load_body()
    marks = with_soles(body, keypoint_landmarks(body, JointSet.COCO_17))
    soles = ["_sole_" in name for name in marks.names]
    heights, by_shape = sole_heights(body, marks)
    assert sum(soles) == 8 and heights[soles].min() >= 0.0 and heights[soles].max() < 0.008
    betas = np.array([2.0, -1.0, 0.5, *np.zeros(7)])
    lowest = (body.v_template[:, 1] + body.shapedirs[:, 1] @ betas).min()
    points = marks.anchors.sum(axis=1)[:, 1] + marks.shapedirs.sum(axis=1)[:, 1] @ betas
    np.testing.assert_allclose((heights + by_shape @ betas)[soles], points[soles] - lowest, atol=2e-3)


def test_ankles_stand_for_feet_without_keypoints() -> None:
    names = ("left_ankle", "left_heel", "right_ankle", "right_heel", "nose")
    assert foot_columns(names, np.array([1.0, 1.0, 1.0, 0.1, 1.0])) == [1, 2]


def test_a_lifted_foot_and_a_fast_one_do_not_stand() -> None:
    points = np.zeros((30, 2, 3))
    points[:, 1, 2] = 0.2
    points[20:, 0, 0] = 0.1 * np.arange(10)
    stands = standing_soles(points, np.zeros(2), UP, np.tile([0.0, 1.0, 0.0], (30, 1)), 30.0)
    assert stands[2:18, 0].all() and not stands[22:, 0].any() and not stands[:, 1].any()


def test_feet_below_a_flat_shin_do_not_stand() -> None:
    names, points = ("left_toe", "left_ankle", "left_knee", "right_toe"), np.zeros((3, 4, 3))
    points[:, 2] = [[0.0, 0.0, 0.4], [0.3, 0.0, 0.25], [0.4, 0.0, 0.0]]
    rising = rising_shins(points, names, [0, 3], np.tile(UP, (3, 1)))
    assert rising.tolist() == [[True, True], [True, True], [False, True]]


@pytest.mark.parametrize("joint_set", [JointSet.BODY_25, JointSet.COCO_17])
def test_toes_of_a_person_who_kneels_show_no_stature(joint_set: JointSet) -> None:
    body, rng = load_body(), np.random.default_rng(5)
    take = filmed("kneels", replace(kneeling(60), betas=betas_of_stature(body, rng, 1.9)), FPS, 1.5, joint_set, rng)
    motion = solve(take.capture).motion
    assert body.stature_of(motion.betas) == pytest.approx(body.stature_m, abs=0.02)
    (stated,) = [item for item in motion.provenance["diagnostics"] if item["code"] == "one_camera"]
    assert stated["values"]["source"] == "typical adult sizes"


@pytest.mark.slow
def test_a_person_in_a_part_of_the_take_still_shows_the_stature() -> None:
    take = person_who_stands(1.95, JointSet.BODY_25, 1.5)
    _, keypoints = take.capture.require_views()
    empty = np.zeros((1, 240, *keypoints.confidence.shape[2:]))
    xy = np.concatenate([keypoints.xy, np.full((*empty.shape, 2), np.nan)], axis=1)
    longer = replace(keypoints, xy=xy, confidence=np.concatenate([keypoints.confidence, empty], axis=1))
    motion = solve(replace(take.capture, keypoints=longer)).motion
    assert load_body().stature_of(motion.betas) > 1.85


def test_one_foot_above_the_other_and_a_floor_from_the_person_are_kept() -> None:
    body = load_body()
    raised = body.v_template.copy()
    raised[raised[:, 0] > 0, 1] += 0.009
    marks = with_soles(replace(body, v_template=raised), keypoint_landmarks(body, JointSet.COCO_17))
    assert len(marks) == JointSet.COCO_17.num_keypoints + 8
    take = person_who_stands(1.7, JointSet.BODY_25, 1.5)
    known = replace(take.capture, stature_m=1.8, floor_from_person=True)
    assert "stature_at_odds" not in {item["code"] for item in solve(known).motion.provenance["diagnostics"]}


def seen_by_camera(take: PersonTake) -> tuple[LiftedTake, Landmarks, tuple[np.ndarray, np.ndarray]]:
    """Return the true pose as a lifted take with exact keypoints, its landmarks, and the camera over the floor."""
    cameras, person, frames = take.capture.cameras, take.person, len(take.joints)
    assert cameras is not None
    R, t = cameras.R[0], cameras.t[0]
    marks = with_soles(person.body, keypoint_landmarks(person.body, JointSet.BODY_25))
    seen = np.asarray(person.pose(marks).points) @ R.T + t
    ahead = np.tile(np.eye(3), (frames, 1, 1))
    view = LiftedView(np.zeros((frames, 32)), R @ person.orient, ahead[:, 2], np.full((frames, 24, 2), 0.05), ahead)
    shown = np.where(["_sole_" in name for name in marks.names], 0.0, 1.0) * np.ones((frames, 1))
    lifted = LiftedTake(view, view.z, person.local, seen[..., :2] / seen[..., 2:], shown, 30.0)
    return lifted, marks, (np.tile(R, (frames, 1, 1)), np.tile(-R.T @ t, (frames, 1)))


def test_planted_feet_are_where_they_are_seen_when_knees_are_lifted_wrongly() -> None:
    take, body = person_who_stands(1.85, JointSet.BODY_25, 1.0), load_body()
    lifted, marks, floor = seen_by_camera(take)
    bent, knees = lifted.local.copy(), [3, 4]
    bent[:, knees] = bent[:, knees] @ exp_so3(np.array([-0.2, 0.0, 0.0]))
    sigma = np.zeros((len(bent), 1 + body.layout.num_solved))
    found = fit_shape(replace(lifted, local=bent), body, marks, sigma, floor)
    assert found.stature_m == pytest.approx(1.85, rel=0.014)  # 1.7 % with the same weight for all points


def test_the_size_is_as_unsure_as_turns_of_the_lifted_pose_make_it() -> None:
    take, body = person_who_stands(1.85, JointSet.BODY_25, 1.5), load_body()
    person, frames, knee, turn = take.person, len(take.joints), 4, 0.02
    lifted, marks, floor = seen_by_camera(take)
    sigma = np.zeros((frames, 1 + body.layout.num_solved))
    sigma[:, knee] = 0.1
    exact, moved = fit_shape(lifted, body, marks, sigma, floor), list[float]()
    alike = round(ALIKE_S * 30.0)
    for axis in turn * np.eye(3):
        for start in range(0, frames, alike):
            local = person.local.copy()
            part = slice(start, start + alike)
            local[part, knee - 1] = local[part, knee - 1] @ exp_so3(axis)
            found = fit_shape(replace(lifted, local=local), body, marks, sigma, floor)
            moved.append((found.stature_m / exact.stature_m - 1.0) / turn * 0.1)
    assert exact.pose_sigma > 0.001
    assert exact.pose_sigma == pytest.approx(np.linalg.norm(moved), rel=0.2)
