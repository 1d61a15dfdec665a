"""Crossed hands, clapping, hands behind the back, somebody else's: fingers where they are, the body where it was."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import pytest

from solver_backend.body.body import load_body
from solver_backend.body.kinematics import forward_kinematics
from solver_backend.exchange.body_layout import SMPL
from solver_backend.exchange.joint_sets import SIDES
from solver_backend.exchange.progress import silent
from solver_backend.fitters.hands.shown_hands import HandViews
from solver_backend.fitters.hands.solve_hands import SolvedHands, follow_hand, solve_hands
from solver_backend.fitters.measurements.views import measure_views
from solver_backend.fitters.model.subject import PosedFrames, Subject
from solver_backend.fitters.problem import Measurements, SolvedFrames
from solver_backend.geometry.rotations import exp_so3
from solver_backend.synthesis.embedded.demo import DEMO_BETAS, author_motion, demo_capture
from solver_backend.synthesis.simulation.cast import Person
from solver_backend.synthesis.studio.person_hands import (
    HandFaults,
    MovingHands,
    detect_hands,
    hidden_points,
    move_hands,
)
from tests.support.short_solves import QUICK

FRAMES, FPS = 24, 30.0
WRISTS = [SMPL.joints.index(f"{side}_wrist") for side in SIDES]
ARMS = [SMPL.joints.index(f"{s}_{part}") - 1 for s in SIDES for part in ("collar", "shoulder", "elbow", "wrist")]


@dataclass(frozen=True)
class Scene:
    """A person whose arms are somewhere, as four views have the hands."""

    views: HandViews
    solved: SolvedFrames
    """The body as it truly is."""
    hands: MovingHands


@lru_cache(maxsize=1)
def measured() -> Measurements:
    return measure_views(demo_capture(FRAMES, FPS, seed=4), load_body(), np.zeros(1), silent)


def scene(where: str, elsewhere_m: float = 0.0) -> Scene:
    """Return the demo's person with the wrists somewhere before or behind the chest."""
    body, cameras = load_body(), demo_capture(FRAMES, FPS, seed=4).cameras
    assert cameras is not None
    motion = author_motion(body, DEMO_BETAS, FRAMES, FPS)
    orient, local = exp_so3(motion.global_orient), exp_so3(motion.body_pose.reshape(FRAMES, -1, 3))
    person = Person(body, DEMO_BETAS, orient, local, motion.transl)
    posed = forward_kinematics(person.body, person.betas, person.orient, person.local, person.transl)
    chest = posed.joints[:, SMPL.joints.index("spine3")]
    left = posed.joints[:, SMPL.joints.index("left_shoulder")] - posed.joints[:, SMPL.joints.index("right_shoulder")]
    left /= np.linalg.norm(left, axis=1, keepdims=True)
    ahead = np.cross(left, [0.0, 0.0, 1.0])
    apart = 0.02 + 0.2 * np.abs(np.sin(np.linspace(0.0, 3.0 * np.pi, FRAMES)))[:, None]
    frames = PosedFrames(person.orient, person.local, person.transl)
    for side, sign in enumerate((1.0, -1.0)):
        wanted = {
            "crossed": chest + (0.28 + 0.08 * side) * ahead - 0.12 * sign * left,
            "clapping": chest + 0.32 * ahead + 0.5 * sign * apart * left,
            "behind the back": chest - 0.22 * ahead + 0.08 * sign * left - [0.0, 0.0, 0.25],
        }[where]
        for _ in range(3):
            now = forward_kinematics(person.body, person.betas, frames.root, frames.local, frames.transl)
            shift = wanted - now.joints[:, WRISTS[side]]
            frames = follow_hand(person.body, person.betas, frames, side, np.zeros((FRAMES, 3)), shift)
    person = Person(person.body, person.betas, person.orient, frames.local, person.transl)
    rng = np.random.default_rng(5)
    hands = move_hands(person, FPS, rng)
    points = hands.points + [elsewhere_m, 0.0, 0.0]
    behind = where == "behind the back"
    hidden = hidden_points(person, cameras, points) if behind else np.zeros((len(cameras.K), *points.shape[:3]), bool)
    found = detect_hands(cameras, points, hidden, FPS, HandFaults(), rng)
    subject = replace(Subject.average(person.body, measured().landmarks, np.zeros(1)), betas=person.betas)
    solved = SolvedFrames(subject, PosedFrames(person.orient, person.local, person.transl))
    views = HandViews(cameras, np.nan_to_num(found[..., :2]), found[..., 2])
    return Scene(views, solved, hands)


def solve_scene(made: Scene) -> tuple[SolvedFrames, SolvedHands]:
    solved, hands = solve_hands(made.views, made.solved, FPS, QUICK, silent)
    assert hands is not None
    return solved, hands


def moved_m(made: Scene, solved: SolvedFrames) -> np.ndarray:
    """Return (F, 2) metres by which wrists left where the body truly has them."""
    joints = [
        forward_kinematics(f.subject.body, f.subject.betas, f.frames.root, f.frames.local, f.frames.transl).joints
        for f in (made.solved, solved)
    ]
    return np.linalg.norm(joints[1] - joints[0], axis=-1)[:, WRISTS]


@pytest.mark.slow
@pytest.mark.parametrize("where", ["crossed", "clapping", "behind the back"])
def test_hands_are_solved_where_they_are(where: str) -> None:
    made = scene(where)
    solved, hands = solve_scene(made)
    local = [frames.frames.local for frames in (made.solved, solved)]
    others = np.delete(np.arange(local[0].shape[1]), ARMS)
    np.testing.assert_array_equal(local[0][:, others], local[1][:, others])
    assert np.median(moved_m(made, solved)) < 0.015
    views = made.views
    assert isinstance(views, HandViews)
    seen = (views.confidence > 0).any(axis=-1).sum(axis=0) >= 2
    assert seen.mean() > 0.3, "the scene shows something"
    for side, hand in hands.hands.items():
        error = np.linalg.norm(hand.points - made.hands.points[:, side], axis=-1)[seen[:, side]]
        assert np.median(error) < 0.015
    codes = {item.code for item in solved.diagnostics}
    assert "hands_exchanged" not in codes


def test_somebody_elses_hands_in_every_view_are_left_out_and_move_nothing() -> None:
    made = scene("crossed", elsewhere_m=0.8)
    solved, hands = solve_scene(made)
    assert {item.code for item in solved.diagnostics} >= {"hand_elsewhere"}
    assert not hands.hands
    np.testing.assert_array_equal(made.solved.frames.local, solved.frames.local)
